"""The figures of a translation, against what they must be."""

import pytest
import torch
import torchvision
from torch import nn

from idapt_pl.evaluation.image_quality import (
    Backbone,
    PairedScores,
    StateError,
    fit_feature_probe,
    kernel_distance,
    newest,
)
from idapt_pl.nets.images import stack_channels


class Colored(torch.utils.data.Dataset):
    """Noisy images around a colour, as stacks of one."""

    def __init__(self, n, color, seed):
        noise = torch.randint(0, 60, (n, 1, 24, 24, 3), generator=torch.Generator().manual_seed(seed))
        self.pixels = (noise + torch.tensor(color)).clamp(0, 255).to(torch.uint8)

    def __len__(self):
        return len(self.pixels)

    def __getitems__(self, index):
        return {"pixels": self.pixels[index]}


def test_kernel_distance_is_near_zero_for_one_distribution_and_grows_with_the_gap():
    x, y = torch.randn(2, 200, 8).unbind()
    same, near, far = (kernel_distance(x, y + shift) for shift in (0.0, 0.5, 2.0))
    assert abs(same) < 0.2 * near and near < 0.2 * far
    assert kernel_distance(x[:5], y) != kernel_distance(x[:5], y), "NaN: too few"


def test_feature_probe_tells_domains_apart_is_reproducible_and_leaves_random_numbers_alone():
    red, blue = Colored(40, (200, 20, 20), 0), Colored(40, (20, 20, 200), 1)
    before = torch.get_rng_state()
    probes = [fit_feature_probe([red, blue], 15, torch.device("cpu")) for _ in range(2)]
    assert torch.equal(before, torch.get_rng_state())
    images = newest(red, range(40), torch.device("cpu"))
    f, again = (p(images) for p in probes)
    assert torch.equal(f, again)
    more_red, blues = (
        probes[0](newest(d, range(40), torch.device("cpu"))) for d in (Colored(40, (200, 20, 20), 2), blue)
    )
    assert kernel_distance(f, more_red) < 0.1 * kernel_distance(f, blues)


def test_paired_scores_are_those_of_the_images_before_and_after():
    target = torch.full((2, 16, 16, 3), 100, dtype=torch.uint8)
    target[:, ::2] = 140
    scores = PairedScores()
    scores.update(target + 10, target + 1, target)
    found = scores.compute()
    assert found["psnr"] == pytest.approx(48.13, abs=0.01) and found["psnr_before"] == pytest.approx(28.13, abs=0.01)
    assert found["ssim_before"] < found["ssim"] <= 1


class Reads(nn.Module):
    """A predictor that sees the state in the first pixel, in units of 10."""

    def forward(self, images):
        return (images[:, :2, 0, 0] + 1) * 127.5 / 10

    def standardise(self, state):
        return state / 10


def test_state_error_is_in_units_of_the_spread():
    pixels = torch.zeros(4, 1, 8, 8, 3, dtype=torch.uint8)
    pixels[:, 0, 0, 0, 0], pixels[:, 0, 0, 0, 1] = 30, 60
    assert stack_channels(pixels).shape == (4, 3, 8, 8)
    error = StateError(Reads())
    error.update(pixels, torch.tensor([[30.0, 40.0]] * 4))
    assert error.compute() == pytest.approx(1.0, abs=1e-4), "none in one component, two units in the other"


def test_backbone_takes_torchvisions_weights_and_refuses_others(tmp_path):
    net = torchvision.models.resnet18(weights=None).eval()
    torch.save(net.state_dict(), tmp_path / "resnet18.pth")
    images = torch.rand(2, 3, 24, 24) * 2 - 1
    assert Backbone(tmp_path / "resnet18.pth")(images).shape == (2, 512)
    torch.save({"a": torch.zeros(1)}, tmp_path / "other.pth")
    for name in ("other.pth", "missing.pth"):
        with pytest.raises(ValueError, match=rf"{name}: .*Expected the weights of torchvision's resnet18"):
            Backbone(tmp_path / name)

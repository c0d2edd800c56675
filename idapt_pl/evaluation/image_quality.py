"""How good is a translation? Figures that need no download. Evaluation only: nothing here trains or selects G."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import torch
import torch.nn.functional as nnf
import torchvision
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.data import Dataset
from torchmetrics import MeanMetric
from torchmetrics.image import PeakSignalNoiseRatio, StructuralSimilarityIndexMeasure
from torchmetrics.image.kid import KernelInceptionDistance

from idapt_pl.checkpoints import read_checkpoint
from idapt_pl.files import blaming
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.nets.images import stack_channels, to_float

FEWEST = 10
"""Images of each kind below which no distance between distributions is given."""


class FeatureProbe(nn.Module):
    """Features of images by a small denoising autoencoder, trained on the very data that are compared.

    Images are brought to 64x64, encoded to 32 channels at 8x8, and pooled to 4x4: 512 features, standardised by
    :func:`fit_feature_probe` to the training images' mean and spread.
    """

    side, channels = 64, 32

    def __init__(self) -> None:
        super().__init__()
        widths = (3, 32, 64, self.channels)
        down = [nn.Conv2d(a, b, 4, 2, 1) for a, b in pairwise(widths)]
        up = [nn.ConvTranspose2d(b, a, 4, 2, 1) for a, b in pairwise(widths)][::-1]
        self.encoder = nn.Sequential(down[0], nn.SiLU(), down[1], nn.SiLU(), down[2])
        self.decoder = nn.Sequential(up[0], nn.SiLU(), up[1], nn.SiLU(), up[2])
        self.register_buffer("mean", torch.zeros(16 * self.channels))
        self.register_buffer("std", torch.ones(16 * self.channels))

    def shrink(self, images: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 64 64"]:
        """Images at the size that is looked at."""
        return nnf.interpolate(images, (self.side, self.side), mode="bilinear", antialias=True, align_corners=False)

    def forward(self, images: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """Standardised features of images, -1..1."""
        pooled = nnf.adaptive_avg_pool2d(self.encoder(self.shrink(images)), 4).flatten(1)
        return (pooled - self.mean) / self.std

    def reconstruction_error(self, images: Float[Tensor, "b 3 h w"]) -> Float[Tensor, ""]:
        """Mean squared error of images restored from noisy ones."""
        small = self.shrink(images)
        noisy = small + 0.1 * torch.randn_like(small)
        return (self.decoder(self.encoder(noisy)) - small).square().mean()


def newest(data: Dataset, index: Sequence[int], device: torch.device) -> Float[Tensor, "b 3 h w"]:
    """The newest frames of some stacks, -1..1."""
    return to_float(data.__getitems__(list(index))["pixels"][:, -1].to(device))


def fit_feature_probe(
    datasets: Sequence[Dataset], batches: int, device: torch.device, batch_size: int = 32, seed: int = 0
) -> FeatureProbe:
    """A feature probe for the images of some datasets, the same for the same data and seed.

    Args:
        datasets: each gives half (a third, ...) of every batch.
        batches: gradient steps.
        device: to fit on.
        batch_size: images in a batch.
        seed: of the probe; the caller's random numbers are left alone.
    """
    with torch.random.fork_rng(), torch.enable_grad(), torch.inference_mode(False):
        torch.manual_seed(seed)
        probe = FeatureProbe().to(device)
        optimizer = torch.optim.Adam(probe.parameters(), lr=1e-3)
        part = max(1, batch_size // len(datasets))

        def draw() -> Tensor:
            return torch.cat([newest(d, torch.randint(len(d), (part,)).tolist(), device) for d in datasets])

        for _ in range(batches):
            optimizer.zero_grad(set_to_none=True)
            probe.reconstruction_error(draw()).backward()
            optimizer.step()
        with torch.no_grad():
            features = torch.cat([probe(draw()) for _ in range(16)])
            probe.mean.copy_(features.mean(0))
            probe.std.copy_(features.std(0).clamp(min=1e-3))
        return probe.eval().requires_grad_(False)


class Backbone(nn.Module):
    """Features of a torchvision ResNet-18 with weights the user has, for example ImageNet's.

    Args:
        weights: file of the network's state dict, as torchvision publishes it.

    Raises:
        ValueError: if the file is not one.
    """

    def __init__(self, weights: Path) -> None:
        super().__init__()
        self.net = torchvision.models.resnet18(weights=None)
        cure = "Expected the weights of torchvision's resnet18."
        with blaming(weights, cure):
            self.net.load_state_dict(read_checkpoint(weights, cure))
        self.net.fc = nn.Identity()
        self.eval().requires_grad_(False)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406])[:, None, None])
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225])[:, None, None])

    def forward(self, images: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b f"]:
        """512 features of images, -1..1."""
        images = nnf.interpolate(images, (224, 224), mode="bilinear", antialias=True, align_corners=False)
        return self.net((images / 2 + 0.5 - self.mean) / self.std)


def kernel_distance(real: Float[Tensor, "n f"], fake: Float[Tensor, "m f"], subset: int = 50) -> float:
    """KID, the squared MMD with a cubic kernel, unbiased (Bińkowski et al. 2018), of features; NaN for too few."""
    fewest = min(len(real), len(fake))
    if fewest < FEWEST:
        return float("nan")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        metric = KernelInceptionDistance(nn.Identity(), subsets=50, subset_size=min(subset, fewest)).to(real.device)
        metric.update(real, real=True)
        metric.update(fake, real=False)
        return float(metric.compute()[0])


class PairedScores(nn.Module):
    """PSNR (dB) and SSIM against the target's image of the same state, of the source and of the translated image."""

    def __init__(self) -> None:
        super().__init__()
        kinds = {"psnr": PeakSignalNoiseRatio(data_range=255.0)}
        kinds["ssim"] = StructuralSimilarityIndexMeasure(data_range=255.0)
        self.scores = nn.ModuleDict({f"{k}{when}": m.clone() for k, m in kinds.items() for when in ("", "_before")})

    def update(self, source: Tensor, translated: Tensor, target: Tensor) -> None:
        """Add newest frames, uint8 (B, H, W, 3) each."""
        source, translated, target = (x.movedim(-1, 1).float() for x in (source, translated, target))
        for name, score in self.scores.items():
            score.update(source if name.endswith("_before") else translated, target)

    def compute(self) -> dict[str, float]:
        """The figures so far."""
        return {name: float(score.compute()) for name, score in self.scores.items()}


class StateError(nn.Module):
    """Mean absolute error of states that a predictor reads off images, in units of their spread.

    Args:
        predictor: P^T, or a probe trained on target images.
    """

    def __init__(self, predictor: PixelStatePredictor) -> None:
        super().__init__()
        self.predictor, self.mean = predictor, MeanMetric()

    @torch.no_grad()
    def update(self, pixels: Tensor, state: Tensor) -> None:
        """Add stacks uint8 (B, K, H, W, 3) and their states (B, s)."""
        predicted = self.predictor(stack_channels(pixels))
        self.mean.update((predicted - self.predictor.standardise(state)).abs())

    def compute(self) -> float:
        """The error so far."""
        return float(self.mean.compute())

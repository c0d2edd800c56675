"""Images to nets and back, encoders, generators."""

import numpy as np
import pytest
import torch

from idapt_pl.nets.encoder import FrameStatePredictor, Keypoints, PixelEncoder, PixelStatePredictor
from idapt_pl.nets.images import center_crop, random_crop, stack_channels, to_float, to_pixels
from idapt_pl.nets.translation import InstanceNorm, PatchDiscriminator, ResnetGenerator, few_channels_out


def random_pixels(*shape):
    return torch.randint(0, 256, (*shape, 3), dtype=torch.uint8)


def test_every_pixel_value_survives_the_round_trip_through_floats():
    pixels = torch.arange(256, dtype=torch.uint8).repeat(3).reshape(16, 16, 3)
    floats = to_float(pixels)
    assert floats.shape == (3, 16, 16) and floats.min() == -1 and floats.max() == 1
    assert torch.equal(to_pixels(floats), pixels)


def test_values_out_of_range_are_clamped_rather_than_wrapped():
    assert to_pixels(torch.full((3, 1, 1), 1.5)).unique().tolist() == [255]
    assert to_pixels(torch.full((3, 1, 1), -1.5)).unique().tolist() == [0]


def test_floats_lie_in_memory_channels_first():
    pixels = torch.randint(256, (2, 1, 8, 6, 3), dtype=torch.uint8)
    assert to_float(pixels).is_contiguous()
    assert stack_channels(pixels).is_contiguous()


def test_stack_channels_puts_frames_one_after_another_oldest_first():
    pixels = random_pixels(2, 3, 8, 8)
    stacked = stack_channels(pixels)
    assert stacked.shape == (2, 9, 8, 8)
    for k in range(3):
        assert torch.equal(stacked[:, 3 * k : 3 * k + 3], to_float(pixels[:, k]))


def test_center_crop_takes_the_middle():
    image = torch.arange(36.0).view(6, 6)
    assert torch.equal(center_crop(image, 2), image[2:4, 2:4])


def test_random_crop_takes_one_window_of_each_stack_anywhere_in_it():
    grid = torch.arange(100, dtype=torch.uint8).view(10, 10)
    pixels = grid[None, None, :, :, None].expand(200, 3, 10, 10, 3).clone()
    crops = random_crop(pixels, 8)
    corners = crops[:, :, 0, 0, 0]
    assert (corners == corners[:, :1]).all(), "frames of a stack must be cropped alike"
    assert set(corners[:, 0].tolist()) == {10 * top + left for top in range(3) for left in range(3)}
    for stack, corner in zip(crops[:5], corners[:5, 0].tolist(), strict=True):
        top, left = divmod(corner, 10)
        assert torch.equal(stack[0, :, :, 0], grid[top : top + 8, left : left + 8])


def test_random_crop_takes_windows_of_any_shape():
    pixels = torch.arange(100, dtype=torch.uint8).view(1, 1, 10, 10, 1).expand(200, 1, 10, 10, 3)
    crops = random_crop(pixels, (9, 4))
    assert crops.shape == (200, 1, 9, 4, 3)
    assert set(crops[:, 0, 0, 0, 0].tolist()) == {10 * top + left for top in range(2) for left in range(7)}
    assert (crops[:, 0, 1:, :, 0] - crops[:, 0, :-1, :, 0] == 10).all()


def test_keypoints_find_where_the_activation_is():
    x = torch.full((1, 2, 5, 9), -50.0)
    x[0, 0, 4, 0] = 50.0  # bottom left
    x[0, 1, 2, 8] = 50.0  # middle right
    columns, rows = Keypoints()(x)[0].view(2, 2)
    torch.testing.assert_close(columns, torch.tensor([-1.0, 1.0]))
    torch.testing.assert_close(rows, torch.tensor([1.0, 0.0]))


@pytest.mark.parametrize("pool", ["flatten", "keypoints"])
def test_encoder_gives_bounded_features_for_any_crop(pool):
    encoder = PixelEncoder(40, frame_stack=2, crop=32, strides=(2, 2, 1, 1), pool=pool, features=7)
    pixels = random_pixels(5, 2, 40, 40)
    for augment in (False, True):
        features = encoder.encode(pixels, augment)
        assert features.shape == (5, 7) and features.abs().max() <= 1 and features.std() > 0


def test_encoder_refuses_a_crop_larger_than_the_image():
    with pytest.raises(ValueError, match=r"crop \(50\).*40"):
        PixelEncoder(40, crop=50)


def test_state_predictor_prediction_standardises_back_to_what_the_net_said():
    net = PixelStatePredictor(PixelEncoder(32, 1, strides=(2, 2, 1, 1)), state_dim=2, hidden=(8,))
    net.fit_scale(torch.tensor([[10.0, 5.0], [14.0, 5.0]]))
    assert net.mean.tolist() == [12.0, 5.0]
    assert net.std[1] == 1.0, "a component that does not vary keeps spread 1"
    pixels = random_pixels(3, 1, 32, 32)
    torch.testing.assert_close(net.standardise(net.predict(pixels)), net.encode(pixels), rtol=1e-4, atol=1e-4)


class Brightness(PixelEncoder):
    """Features that are the brightness of the image, so that a test can say what a frame shows."""

    def forward(self, images):
        return images.mean((1, 2, 3))[:, None]


@pytest.mark.parametrize(("frames", "acceleration"), [(3, 0.0), (3, 7.0), (2, 0.0)])
def test_rate_from_differences_is_the_derivative_of_what_the_frames_show(frames, acceleration):
    """Exact for constant velocity, and with three frames for constant acceleration."""
    dt, mean, std = 0.1, torch.tensor([2.0, 1.0]), torch.tensor([4.0, 0.5])
    net = PixelStatePredictor(Brightness(8, 1, strides=(2,)), state_dim=2, rates={1: 0}, dt=dt)
    net.mlp, net.mean, net.std = torch.nn.Identity(), mean, std
    t = torch.arange(1.0 - frames, 1.0) * dt  # the newest frame is now
    position = 3.0 + 5.0 * t + acceleration * t**2 / 2
    shown = (position - mean[0]) / std[0]  # standardised, as the net predicts it
    images = shown.repeat_interleave(3)[None, :, None, None].expand(1, 3 * frames, 8, 8)
    state = net(images) * std + mean
    torch.testing.assert_close(state, torch.tensor([[3.0, 5.0]]), rtol=1e-4, atol=1e-4)


def test_the_rate_of_what_does_not_vary_is_no_large_number():
    """A joint that is held moves by micrometres a second; what the net guesses differs by more between frames."""
    net = PixelStatePredictor(PixelEncoder(32, 3, strides=(2, 2, 1, 1)), state_dim=3, hidden=(8,), rates={2: 1}, dt=0.1)
    held = torch.stack([torch.linspace(-1, 1, 50), torch.full((50,), 0.04), 3e-6 * torch.randn(50)], 1)
    net.fit_scale(held)
    assert net.std[0] < 1 and net.std[1] == net.std[2] == 1.0
    moving = torch.stack([held[:, 0], held[:, 0], 3e-6 * torch.randn(50)], 1)
    net.fit_scale(moving)
    assert net.std[2] < 1e-5, "where the position varies its rate counts, however small"


def test_framewise_predictor_starts_from_the_newest_frame_and_learns_motion_from_the_others():
    """Brightness is the position; the velocity can only come from how it changes over the frames."""
    torch.manual_seed(0)
    net = FrameStatePredictor(Brightness(8, 1, strides=(2,), features=1), state_dim=2, frame_stack=3, hidden=(32, 32))
    x, v = torch.rand(2, 256, 1) - 0.5
    images = (x + v * torch.tensor([-0.2, -0.1, 0.0])).repeat_interleave(3, 1)[..., None, None].expand(-1, -1, 8, 8)
    same = torch.cat([torch.rand(256, 6, 8, 8), images[:, -3:]], 1)
    torch.testing.assert_close(net(images), net(same))  # a new net does not heed older frames
    state = torch.cat([x, v], 1)
    net.fit_scale(state)
    optimizer = torch.optim.Adam(net.parameters(), lr=3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        net.error(images, state).backward()
        optimizer.step()
    error = (net(images) - net.standardise(state)).abs().mean(0)
    assert error[0] < 0.1 and error[1] < 0.3, error


@pytest.mark.parametrize("size", [32, 36])
def test_generator_keeps_the_image_size_and_range(size):
    image = torch.rand(2, 3, size, size) * 2 - 1
    fake = ResnetGenerator(3, width=4, blocks=1)(image)
    assert fake.shape == image.shape and fake.abs().max() <= 1


def test_generator_without_a_background_cannot_start_from_an_image():
    with pytest.raises(ValueError, match="has no background"):
        ResnetGenerator(3, 4, 1).start_from(torch.zeros(3, 16, 16))


def test_generator_treats_each_image_of_a_batch_on_its_own():
    G, images = ResnetGenerator(3, width=4, blocks=1), torch.rand(3, 3, 32, 32)
    torch.testing.assert_close(G(images)[1:2], G(images[1:2]), rtol=1e-4, atol=1e-5)


def outputs_and_gradients(net, x):
    """What a net gives, and the gradients of a weighted sum of it by its input and parameters."""
    x = x.clone().requires_grad_()
    y = net(x)
    weights = torch.linspace(-1, 1, y.numel()).view(y.shape)
    return [y, *torch.autograd.grad((y * weights).sum(), [x, *net.parameters()])]


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_instance_norm_is_pytorchs(layout):
    ours, theirs = InstanceNorm(6), torch.nn.InstanceNorm2d(6, affine=True)
    torch.nn.init.normal_(ours.weight)
    torch.nn.init.normal_(ours.bias)
    theirs.load_state_dict(ours.state_dict())
    x = (3 * torch.randn(4, 6, 9, 7) + 1).contiguous(memory_format=layout)
    for mine, reference in zip(outputs_and_gradients(ours, x), outputs_and_gradients(theirs, x), strict=True):
        torch.testing.assert_close(mine, reference, atol=1e-4, rtol=1e-4)


def test_convolution_to_few_channels_is_pytorchs_and_leaves_memory_as_it_was():
    conv = torch.nn.Conv2d(16, 3, 7)

    class Ours(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.conv = conv

        def forward(self, x):
            return few_channels_out(self.conv, x)

    x = torch.randn(2, 16, 15, 13)
    found, expected = outputs_and_gradients(Ours(), x), outputs_and_gradients(conv, x)
    for mine, reference in zip(found, expected, strict=True):
        torch.testing.assert_close(mine, reference, atol=1e-3, rtol=1e-4)
    assert found[0].is_contiguous()
    assert found[1].is_contiguous()


def test_patch_discriminator_judges_patches():
    D = PatchDiscriminator(3, width=4)
    image = torch.rand(1, 3, 64, 64)
    logits = D(image)
    assert logits.shape[:2] == (1, 1) and logits.numel() > 1
    image.requires_grad_(True)
    D.body[0](image)[0, 0, 0, 0].backward()  # the first layer of the corner sees the corner alone
    seen = np.argwhere(image.grad[0].abs().sum(0).numpy() > 0)
    assert seen.max() < 4


@pytest.mark.parametrize(("layers", "side"), [(1, 16), (2, 34), (3, 70)])
def test_patches_have_the_size_that_pix2pix_says(layers, side):
    D = PatchDiscriminator(3, 4, layers)
    D.body = torch.nn.Sequential(*(m for m in D.body if not isinstance(m, torch.nn.InstanceNorm2d)))  # sees all
    image = torch.rand(1, 3, 128, 128, requires_grad=True)
    logits = D(image)
    logits[0, 0, logits.shape[2] // 2, logits.shape[3] // 2].backward()
    seen = np.argwhere(image.grad[0].abs().sum(0).numpy() > 0)
    assert (np.ptp(seen, axis=0) + 1).tolist() == [side, side]

"""The image encoder of the policy and of the state predictors: 4 convolutions to 50 features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from idapt_pl.nets.images import center_crop, height_width, random_crop, stack_channels
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.units import Units, give_in_units, take_in_units
from idapt_pl.ranges import Range, check_ranges

Pool = Literal["flatten", "keypoints"]
FrameValues = TypeVar("FrameValues", Tensor, np.ndarray)


def orthogonal_init(module: nn.Module) -> None:
    """Delta-orthogonal convolutions and orthogonal linear layers, zero biases (as in RAD and DrQ)."""
    if isinstance(module, nn.Linear):
        nn.init.orthogonal_(module.weight)
        nn.init.zeros_(module.bias)
    elif isinstance(module, nn.Conv2d):
        nn.init.zeros_(module.weight)
        nn.init.zeros_(module.bias)
        mid = module.weight.shape[-1] // 2
        nn.init.orthogonal_(module.weight.data[:, :, mid, mid], nn.init.calculate_gain("relu"))


class Keypoints(nn.Module):
    """Spatial soft-argmax: the expected position of each channel's activation (Levine et al. 2016, sec. 5.1)."""

    def __init__(self) -> None:
        super().__init__()
        self.log_sharpness = nn.Parameter(torch.ones(()))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b two_c"]:
        """Column then row of every channel, -1..1."""
        x = x.float()
        p = (x.flatten(2) * self.log_sharpness.exp()).softmax(-1).view_as(x)
        cols, rows = (torch.linspace(-1, 1, n, device=x.device) for n in (x.shape[-1], x.shape[-2]))
        return torch.cat([(p.sum(2) * cols).sum(-1), (p.sum(3) * rows).sum(-1)], -1)


class PixelEncoder(nn.Module):
    """f: a frame stack to a feature vector. 4 convolutions (32 channels, 3x3), linear, LayerNorm, tanh.

    Args:
        image_size: side, or height and width, pixels; images are cropped to ``crop`` (at random when training, else
            the middle).
        frame_stack: K frames of 3 channels.
        crop: side of the crop, pixels; None takes the whole image.
        strides: of the convolutions.
        channels: of the convolutions.
        features: size of f(o).
        pool: ``flatten`` (the paper) or ``keypoints``, where in the image each channel is active: positions
            finer than a pixel from few images.

    Raises:
        ValueError: if the crop is larger than the image.
    """

    def __init__(
        self,
        image_size: int | Sequence[int],
        frame_stack: int = 3,
        crop: int | None = None,
        strides: Sequence[int] = (2, 1, 1, 1),
        channels: int = 32,
        features: int = 50,
        pool: Pool = "flatten",
    ) -> None:
        super().__init__()
        self.crop = crop or image_size
        height, width = height_width(self.crop)
        if height > height_width(image_size)[0] or width > height_width(image_size)[1]:
            raise ValueError(f"crop ({self.crop}) is larger than the image ({image_size} pixels)")
        ins = [3 * frame_stack] + [channels] * (len(strides) - 1)
        self.convs = nn.ModuleList(nn.Conv2d(i, channels, 3, stride=s) for i, s in zip(ins, strides, strict=True))
        for stride in strides:
            height, width = (height - 3) // stride + 1, (width - 3) // stride + 1
            if height < 1 or width < 1:
                raise ValueError(
                    f"of {self.crop} pixels nothing is left after convolutions with strides {list(strides)}"
                )
        self.pool = {"flatten": nn.Flatten, "keypoints": Keypoints}[pool]()
        pooled = channels * height * width if pool == "flatten" else 2 * channels
        self.head = nn.Sequential(nn.Linear(pooled, features), nn.LayerNorm(features), nn.Tanh())
        self.features = features
        self.apply(orthogonal_init)
        self.to(memory_format=torch.channels_last)  # strided convolutions of few channels are faster so

    def forward(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b f"]:
        """Features of cropped images, -1..1."""
        x = images
        for conv in self.convs[:-1]:
            x = conv(x).relu()
        x = self.convs[-1](x)  # keypoints take signed activations
        return self.head(self.pool(x) if isinstance(self.pool, Keypoints) else self.pool(x.relu())).float()

    def encode(self, pixels: UInt8[Tensor, "b k h w 3"], augment: bool = False) -> Float[Tensor, "b f"]:
        """Features of frame stacks; ``augment`` crops at random."""
        if augment:
            return self(stack_channels(random_crop(pixels, self.crop)))
        return self(center_crop(stack_channels(pixels), self.crop))


def backward_difference(frames: FrameValues) -> FrameValues:
    """What changes from frame to frame, (...), at the last of ``frames`` (k, ...); of second order if k > 2."""
    last = frames[-1] - frames[-2]
    return 1.5 * last - 0.5 * (frames[-2] - frames[-3]) if len(frames) > 2 else last


def known_error(estimate: Float[Tensor, "b s"], target: Float[Tensor, "b s"]) -> Float[Tensor, ""]:
    """Mean absolute error; where the target is NaN there is none, nor a gradient."""
    return torch.where(target.isnan(), 0.0, estimate - target).abs().mean()


class PixelStatePredictor(nn.Module):
    """P: a frame stack to the state. Encoder and a 2-layer MLP, predicting standardised states.

    With ``rates`` it predicts from single frames what a single frame shows, and takes the rates of change
    from differences between frames: s_i' ≈ (3/2 (s_i(t) - s_i(t-1)) - 1/2 (s_i(t-1) - s_i(t-2))) / dt, the
    second-order backward difference. Errors that neighbouring frames share then cancel.

    ``mean`` and ``std`` (buffers, set from data by :meth:`fit_scale`) turn predictions into units.

    Args:
        encoder: for K frames, or for one frame if there are ``rates``.
        state_dim: size of the state.
        hidden: of the MLP.
        rates: state component to the component it is the rate of; None predicts all from the whole stack.
        dt: control period, s.
    """

    def __init__(
        self,
        encoder: PixelEncoder,
        state_dim: int,
        hidden: Sequence[int] = (256, 256),
        rates: dict[int, int] | None = None,
        dt: float = 1.0,
    ) -> None:
        super().__init__()
        self.encoder, self.rates, self.dt = encoder, rates or {}, dt
        self.shown = [i for i in range(state_dim) if i not in self.rates]
        self.mlp = mlp(encoder.features, hidden, len(self.shown))
        self.mlp.apply(orthogonal_init)
        self.register_buffer("mean", torch.zeros(state_dim))
        self.register_buffer("std", torch.ones(state_dim))

    @property
    def features(self) -> int:
        """Size of :meth:`encode`."""
        return len(self.mean)

    def forward(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b s"]:
        """Standardised state of uncropped image stacks, -1..1."""
        images = center_crop(images, self.encoder.crop)
        if not self.rates:
            return self.mlp(self.encoder(images)).float()
        frames = images.unflatten(1, (-1, 3))
        k = frames.shape[1]
        shown = self.mlp(self.encoder(frames.flatten(0, 1))).float().unflatten(0, (-1, k))  # (b, k, shown)
        state = shown.new_zeros(len(images), self.features)
        state[:, self.shown] = shown[:, -1]
        slope = backward_difference(shown.transpose(0, 1))
        for rate, of in self.rates.items():
            per_second = slope[:, self.shown.index(of)] * self.std[of] / self.dt
            state[:, rate] = (per_second - self.mean[rate]) / self.std[rate]
        return state

    def error(self, images: Float[Tensor, "b c h w"], state: Float[Tensor, "b s"]) -> Float[Tensor, ""]:
        """Mean absolute error on standardised states; with ``rates``, of what the newest frame shows.

        Components that are NaN are not known, and count as right.
        """
        target = self.standardise(state)
        if not self.rates:
            return known_error(self(images), target)
        newest = center_crop(images[:, -3:], self.encoder.crop)
        return known_error(self.mlp(self.encoder(newest)).float(), target[:, self.shown])

    def encode(self, pixels: UInt8[Tensor, "b k h w 3"], augment: bool = False) -> Float[Tensor, "b s"]:
        """The estimated state, standardised, as features; ``augment`` crops at random."""
        return self(stack_channels(random_crop(pixels, self.encoder.crop) if augment else pixels))

    def predict(self, pixels: UInt8[Tensor, "b k h w 3"]) -> Float[Tensor, "b s"]:
        """State in its own units."""
        return self(stack_channels(pixels)) * self.std + self.mean

    def standardise(self, state: Float[Tensor, "b s"]) -> Float[Tensor, "b s"]:
        """States in units of the training data's spread."""
        return (state - self.mean) / self.std

    def fit_scale(self, states: Float[Tensor, "n s"]) -> None:
        """Take mean and spread from data; a component that does not vary keeps spread 1, and so does its rate.

        Such a rate is never quite 0. In units of its spread the noise of what is read would be tens of thousands.
        A net that has a scale already goes on predicting the same states.
        """
        before, is_new = Units.of(self), not self.mean.any() and bool((self.std == 1).all())
        self.mean.copy_(states.mean(0))
        std = states.std(0)
        varies = std > 1e-6
        for rate, of in self.rates.items():
            varies[rate] &= varies[of]
        self.std.copy_(torch.where(varies, std, torch.ones_like(std)))
        if not is_new:
            self._tell_in_units(before, Units.of(self))

    def _tell_in_units(self, before: Units, now: Units) -> None:
        """Predict the same states, standardised by ``now`` and no longer by ``before``."""
        shown = (Units(u.mean[self.shown], u.std[self.shown]) for u in (before, now))
        give_in_units(self.mlp[-1].weight, self.mlp[-1].bias, *shown)


class FrameStatePredictor(PixelStatePredictor):
    """P that looks at each frame alone: an estimate for every frame, and what the sequence of estimates adds.

    One encoder sees K times as many images, and what moves is learned from how poses follow one another, which takes
    fewer images than learning it from stacked pixels. The addition is zero in a new net.

    Args:
        encoder: for one frame.
        state_dim: size of the state.
        frame_stack: K.
        hidden: of both MLPs.
    """

    def __init__(
        self, encoder: PixelEncoder, state_dim: int, frame_stack: int, hidden: Sequence[int] = (256, 256)
    ) -> None:
        super().__init__(encoder, state_dim, hidden)
        self.motion = mlp(frame_stack * state_dim, hidden, state_dim)
        self.motion.apply(orthogonal_init)
        nn.init.zeros_(self.motion[-1].weight)

    def forward(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b s"]:
        """Standardised state of uncropped image stacks, -1..1."""
        frames = center_crop(images, self.encoder.crop).unflatten(1, (-1, 3))
        each = self.mlp(self.encoder(frames.flatten(0, 1))).float().unflatten(0, (-1, frames.shape[1]))
        return each[:, -1] + self.motion(each.flatten(1)).float()

    def _tell_in_units(self, before: Units, now: Units) -> None:
        super()._tell_in_units(before, now)
        first, last = self.motion[0], self.motion[-1]
        frames = first.in_features // self.features
        take_in_units(first.weight, first.bias, before.repeated(frames), now.repeated(frames))
        give_in_units(last.weight, last.bias, before.of_differences, now.of_differences)


@dataclass(frozen=True)
class Vision:
    """How the policy and the state predictors look at images, the same for all.

    Args:
        crop: side of the crop, pixels (random when the policy trains, else centred); default the whole image.
        strides: of the 4 convolutions.
        pool: ``flatten`` (the paper) or ``keypoints`` (where in the image each channel is active).
        rates: velocities ``learned`` from the stack (the paper), taken as ``differences`` between frames, or learned
            from estimates for each of the ``frames``, which suits long control periods.
    """

    crop: int | None = None
    strides: tuple[int, int, int, int] = (2, 1, 1, 1)
    pool: Pool = "flatten"
    rates: Literal["learned", "differences", "frames"] = "learned"

    def __post_init__(self) -> None:
        check_ranges("vision", vars(self), {"crop": Range(1, 4096), "strides": Range(1, 8)})

    def encoder(self, image_size: int | Sequence[int], frame_stack: int) -> PixelEncoder:
        """A new encoder of stacks of K frames of this size (a side, or height and width, pixels)."""
        return PixelEncoder(image_size, frame_stack, self.crop, self.strides, pool=self.pool)

    def predictor(
        self, image_size: int | Sequence[int], frame_stack: int, state_dim: int, rates: dict[int, int], dt: float
    ) -> PixelStatePredictor:
        """A new state predictor.

        Args:
            image_size: side, or height and width, pixels.
            frame_stack: K.
            state_dim: size of the state.
            rates: state component to the component it is the rate of.
            dt: control period, s.
        """
        if self.rates == "frames":
            return FrameStatePredictor(self.encoder(image_size, 1), state_dim, frame_stack)
        if self.rates == "learned" or not rates:
            return PixelStatePredictor(self.encoder(image_size, frame_stack), state_dim)
        return PixelStatePredictor(self.encoder(image_size, 1), state_dim, rates=rates, dt=dt)

"""The image encoder of the policy and of the state predictors: 4 convolutions to 50 features."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from idapt_pl.nets.images import center_crop, random_crop, stack_channels
from idapt_pl.nets.mlp import mlp


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


class PixelEncoder(nn.Module):
    """f: a frame stack to a feature vector. 4 convolutions (32 channels, 3x3), linear, LayerNorm, tanh.

    Args:
        image_size: pixels; images are cropped to ``crop`` (at random when training, else the middle).
        frame_stack: K frames of 3 channels.
        crop: side of the crop, pixels.
        strides: of the convolutions.
        channels: of the convolutions.
        features: size of f(o).
    """

    def __init__(
        self,
        image_size: int,
        frame_stack: int = 3,
        crop: int | None = None,
        strides: Sequence[int] = (2, 1, 1, 1),
        channels: int = 32,
        features: int = 50,
    ) -> None:
        super().__init__()
        self.crop = crop or image_size
        if self.crop > image_size:
            raise ValueError(f"crop ({self.crop}) is larger than the image ({image_size} pixels)")
        ins = [3 * frame_stack] + [channels] * (len(strides) - 1)
        self.convs = nn.ModuleList(nn.Conv2d(i, channels, 3, stride=s) for i, s in zip(ins, strides, strict=True))
        side = self.crop
        for stride in strides:
            side = (side - 3) // stride + 1
        self.head = nn.Sequential(nn.Linear(channels * side * side, features), nn.LayerNorm(features), nn.Tanh())
        self.features = features
        self.apply(orthogonal_init)

    def forward(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b f"]:
        """Features of cropped images, -1..1."""
        x = images
        for conv in self.convs:
            x = conv(x).relu()
        return self.head(x.flatten(1)).float()

    def encode(self, pixels: UInt8[Tensor, "b k h w 3"], augment: bool = False) -> Float[Tensor, "b f"]:
        """Features of frame stacks; ``augment`` crops at random."""
        crop = random_crop if augment else center_crop
        return self(crop(stack_channels(pixels), self.crop))


class PixelStatePredictor(nn.Module):
    """P: a frame stack to the state. Encoder and a 2-layer MLP, predicting standardised states.

    ``mean`` and ``std`` (buffers, set from data by :meth:`standardise`) turn predictions into units.
    """

    def __init__(self, encoder: PixelEncoder, state_dim: int, hidden: Sequence[int] = (256, 256)) -> None:
        super().__init__()
        self.encoder = encoder
        self.mlp = mlp(encoder.features, hidden, state_dim)
        self.mlp.apply(orthogonal_init)
        self.register_buffer("mean", torch.zeros(state_dim))
        self.register_buffer("std", torch.ones(state_dim))

    def forward(self, images: Float[Tensor, "b c h w"]) -> Float[Tensor, "b s"]:
        """Standardised state of uncropped image stacks, -1..1."""
        return self.mlp(self.encoder(center_crop(images, self.encoder.crop))).float()

    @property
    def features(self) -> int:
        """Size of :meth:`encode`."""
        return len(self.mean)

    def encode(self, pixels: UInt8[Tensor, "b k h w 3"]) -> Float[Tensor, "b s"]:
        """The standardised state as features, for an action transformation on estimated states."""
        return self(stack_channels(pixels))

    def predict(self, pixels: UInt8[Tensor, "b k h w 3"]) -> Float[Tensor, "b s"]:
        """State in its own units."""
        return self(stack_channels(pixels)) * self.std + self.mean

    def standardise(self, state: Float[Tensor, "b s"]) -> Float[Tensor, "b s"]:
        """States in units of the training data's spread."""
        return (state - self.mean) / self.std

    def fit_scale(self, states: Float[Tensor, "n s"]) -> None:
        """Take mean and spread from data; a component that does not vary keeps spread 1."""
        self.mean.copy_(states.mean(0))
        std = states.std(0)
        self.std.copy_(torch.where(std > 1e-6, std, torch.ones_like(std)))

"""Generator and discriminator of CycleGAN (Zhu et al. 2017, appendix)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn


def gan_init(module: nn.Module) -> None:
    """Normal(0, 0.02) convolutions, as CycleGAN."""
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
        nn.init.normal_(module.weight, 0.0, 0.02)
        if module.bias is not None:
            nn.init.zeros_(module.bias)


class InstanceNorm(nn.InstanceNorm2d):
    """Instance norm with scale and shift. On CPUs by the kernel of group norm, the same in a fraction of the time.

    Unless channels are last in memory, where that kernel is the slower one.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, affine=True)

    def forward(self, x: Tensor) -> Tensor:
        if x.device.type != "cpu" or not x.is_contiguous():
            return super().forward(x)
        return nn.functional.group_norm(x, self.num_features, self.weight, self.bias, self.eps)


def conv_block(ins: int, outs: int, kernel: int, stride: int = 1) -> nn.Sequential:
    """Reflection padding, convolution (``ins`` to ``outs`` channels), instance norm, ReLU."""
    return nn.Sequential(
        nn.ReflectionPad2d(kernel // 2),
        nn.Conv2d(ins, outs, kernel, stride=stride),
        InstanceNorm(outs),
        nn.ReLU(inplace=True),
    )


class _GradientLikeInput(torch.autograd.Function):
    """To channels last, and the gradient back from there: all layers before would get theirs so, and be slower."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return x.contiguous(memory_format=torch.channels_last)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        return gradient.contiguous()


def few_channels_out(conv: nn.Conv2d, x: Tensor) -> Tensor:
    """A convolution to few channels, which CPUs compute in half the time with channels last; so is its gradient."""
    if x.device.type != "cpu":
        return conv(x)
    return conv(_GradientLikeInput.apply(x)).contiguous()


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions around a skip connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            conv_block(channels, channels, 3),
            nn.ReflectionPad2d(1),
            nn.Conv2d(channels, channels, 3),
            InstanceNorm(channels),
        )

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


class ResnetGenerator(nn.Module):
    """c7s1, two stride-2 convolutions, ``blocks`` residual blocks, two upsamplings, c7s1, tanh.

    Instance norm throughout, so training and evaluation agree and a batch of one is like any other.
    Any image size divisible by 4 is kept.

    Args:
        channels: of the images, 3 or 3K.
        width: channels after the first layer (ngf).
        blocks: residual blocks, 9 in CycleGAN for 256 pixels, 6 for 128.
        background: height and width of images all seen by a camera that stands still. What the network gives is then
            added to a learned image, before tanh, which :meth:`start_from` sets. None leaves it out (CycleGAN).
    """

    def __init__(
        self, channels: int = 3, width: int = 64, blocks: int = 9, background: Sequence[int] | None = None
    ) -> None:
        super().__init__()
        layers = [
            conv_block(channels, width, 7),
            conv_block(width, 2 * width, 3, 2),
            conv_block(2 * width, 4 * width, 3, 2),
        ]
        layers += [ResidualBlock(4 * width) for _ in range(blocks)]
        for ins, outs in ((4 * width, 2 * width), (2 * width, width)):
            layers.append(
                nn.Sequential(
                    nn.ConvTranspose2d(ins, outs, 3, stride=2, padding=1, output_padding=1),
                    InstanceNorm(outs),
                    nn.ReLU(inplace=True),
                )
            )
        self.body = nn.Sequential(*layers, nn.ReflectionPad2d(3), nn.Conv2d(width, channels, 7))
        self.apply(gan_init)
        self.background = nn.Parameter(torch.zeros(channels, *background)) if background else None

    @torch.no_grad()
    def start_from(self, image: Float[Tensor, "c h w"]) -> None:
        """Begin as the net that gives this image, -1..1, whatever it is shown.

        Raises:
            ValueError: if the net was made without a background.
        """
        if self.background is None:
            raise ValueError("this generator has no background to start from; make it with background=(height, width)")
        self.background.copy_(torch.atanh(image.clamp(-0.99, 0.99)))
        nn.init.zeros_(self.body[-1].weight)
        nn.init.zeros_(self.body[-1].bias)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Translate images, -1..1.

        Raises:
            ValueError: if there is a background of another size.
        """
        out = few_channels_out(self.body[-1], self.body[:-1](x)).float()
        if self.background is None:
            return torch.tanh(out)
        if out.shape[1:] != self.background.shape:
            (h, w), (height, width) = self.background.shape[1:], out.shape[2:]
            raise ValueError(f"the background has {h} x {w} pixels, and the images have {height} x {width}")
        return torch.tanh(out + self.background)

    def features(self, x: Float[Tensor, "b c h w"], layers: Sequence[int]) -> list[Tensor]:
        """Activations after some of the layers, counted from the first convolution (0)."""
        found = []
        for i, layer in enumerate(self.body[: max(layers) + 1]):
            x = layer(x)
            if i in layers:
                found.append(x)
        return found


class PatchDiscriminator(nn.Module):
    """PatchGAN: ``layers`` stride-2 convolutions, then a map of logits, one a patch.

    Args:
        channels: of the images.
        width: channels after the first layer (ndf).
        layers: stride-2 layers; 3 gives 70x70 patches.
    """

    def __init__(self, channels: int = 3, width: int = 64, layers: int = 3) -> None:
        super().__init__()
        body: list[nn.Module] = [nn.Conv2d(channels, width, 4, 2, 1), nn.LeakyReLU(0.2, inplace=True)]
        for i in range(layers):
            ins, outs = width * min(2**i, 8), width * min(2 ** (i + 1), 8)
            stride = 2 if i < layers - 1 else 1
            body += [
                nn.Conv2d(ins, outs, 4, stride, 1),
                InstanceNorm(outs),
                nn.LeakyReLU(0.2, inplace=True),
            ]
        self.body = nn.Sequential(*body, nn.Conv2d(width * min(2**layers, 8), 1, 4, 1, 1))
        self.apply(gan_init)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 1 ph pw"]:
        """Logits of "real", one a patch."""
        return self.body(x).float()

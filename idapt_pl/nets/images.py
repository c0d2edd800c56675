"""Between images as they are kept (uint8, channels last) and as nets take them (float, channels first)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import torch
from jaxtyping import Float, Shaped, UInt8
from torch import Tensor


def to_float(pixels: UInt8[Tensor, "... h w c"]) -> Float[Tensor, "... c h w"]:
    """0..255 to -1..1, channels first, in memory too. The only place where pixels become floats.

    As a view they would make all layers of a CycleGAN compute channels last, where CPUs are slower at norm and padding.
    """
    floats = pixels.movedim(-1, -3).to(torch.float32, memory_format=torch.contiguous_format)
    return floats.div_(127.5).sub_(1.0)


def to_pixels(images: Float[Tensor, "... c h w"]) -> UInt8[Tensor, "... h w c"]:
    """-1..1 to 0..255 with rounding, channels last; the inverse of :func:`to_float`."""
    return images.float().add(1.0).mul_(127.5).round_().clamp_(0, 255).to(torch.uint8).movedim(-3, -1)


def stack_channels(pixels: UInt8[Tensor, "b k h w 3"]) -> Float[Tensor, "b c h w"]:
    """A stack of K frames as one image of 3K channels, -1..1."""
    return to_float(pixels).flatten(1, 2)


def height_width(size: int | Sequence[int]) -> tuple[int, int]:
    """Height and width, pixels, of a size given as a side or as both."""
    return (size, size) if isinstance(size, int) else (int(size[0]), int(size[1]))


def center_crop(images: Shaped[Tensor, "*b h w"], size: int | Sequence[int]) -> Shaped[Tensor, "*b height width"]:
    """The middle ``size`` pixels (a side, or height and width) of the last two dimensions."""
    height, width = height_width(size)
    top, left = (images.shape[-2] - height) // 2, (images.shape[-1] - width) // 2
    return images[..., top : top + height, left : left + width]


def random_crop(pixels: UInt8[Tensor, "b k h w 3"], size: int | Sequence[int]) -> UInt8[Tensor, "b k height width 3"]:
    """A random window (a side, or height and width) for each stack; on bytes, before they are four times as many."""
    b, _, h, w, _ = pixels.shape
    height, width = height_width(size)
    tops, lefts = torch.randint(h - height + 1, (b,)).tolist(), torch.randint(w - width + 1, (b,)).tolist()
    windows = [p[:, t : t + height, s : s + width] for p, t, s in zip(pixels, tops, lefts, strict=True)]
    return torch.stack(windows)


def jitter(images: Float[Tensor, "b c h w"], strength: float) -> Float[Tensor, "b c h w"]:
    """Another gain and offset for every channel of every image, and pixel noise; 0 leaves images as they are.

    Args:
        images: -1..1.
        strength: gains within 1 ± strength, offsets within ± strength/2, noise of standard deviation up to strength/5.
    """
    if not strength:
        return images
    b, c = images.shape[:2]
    gain, offset = (2 * torch.rand(2, b, c, 1, 1, device=images.device) - 1) * strength
    noise = torch.randn_like(images) * torch.rand(b, 1, 1, 1, device=images.device) * strength / 5
    return images * (1 + gain) + offset / 2 + noise


def relight(images: Float[Tensor, "b c h w"], strength: float) -> Float[Tensor, "b c h w"]:
    """Each stack of frames in another light: its contrast, brightness and tint; every fifth stays as it is.

    A power law darkens what is dark and leaves what is bright, as a lamp does that is farther away.

    Args:
        images: stacks of frames of 3 channels, -1..1.
        strength: logarithms of brightness are within ± strength, of the power law's exponent within -strength and 1.5
            strength, of each colour's gain within ± 0.3 strength; 0 leaves images as they are.
    """
    if not strength:
        return images
    b, c = images.shape[:2]

    def drawn(low: float, high: float, channels: int = 1) -> Tensor:
        return torch.empty(b, channels, 1, 1, device=images.device).uniform_(low * strength, high * strength).exp()

    gain = drawn(-1.0, 1.0) * drawn(-0.3, 0.3, 3).repeat(1, c // 3, 1, 1)
    lit = (((images + 1) / 2).clamp(1e-4, 1) ** drawn(-1.0, 1.5) * gain).clamp(0, 1) * 2 - 1
    as_it_is = torch.rand(b, 1, 1, 1, device=images.device) < 0.2
    return torch.where(as_it_is, images, lit)


def mean_images(batches: Iterable, frames: int, most: int = 200) -> dict[str, Tensor]:
    """Mean of the newest frames of the stacks of both domains, as channels, (3 frames, H, W), -1..1.

    Args:
        batches: of :class:`datamodules.UnpairedImages` or :class:`datamodules.images.ImageDomains`.
        frames: how many of a stack's frames.
        most: batches that are looked at.
    """
    sums: dict[str, list[Tensor]] = {"source": [], "target": []}
    for batch in itertools.islice(batches, most):
        batch = batch[0] if isinstance(batch, tuple) else batch  # Lightning's CombinedLoader gives indices too
        for domain, seen in sums.items():
            seen.append(stack_channels(batch[domain]["pixels"][:, -frames:]).mean(0))
    return {domain: torch.stack(seen).mean(0) for domain, seen in sums.items()}


def in_one_pass(net: torch.nn.Module, parts: dict[str, Tensor | None]) -> dict[str, Tensor | None]:
    """Images of several kinds through a net in one pass; None stays None."""
    given = {name: images for name, images in parts.items() if images is not None}
    out = net(torch.cat(list(given.values()))).split([len(images) for images in given.values()])
    return dict.fromkeys(parts) | dict(zip(given, out, strict=True))

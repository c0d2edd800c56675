"""Augmentation of whole batches where they are, on bytes, after they reached the device."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Augmentation:
    """What is done to training images at random; all frames of a stack alike.

    Args:
        crop: height and width of a random window, multiples of 4, pixels; None takes the whole image.
        flip: mirror half of the images left to right.
    """

    crop: tuple[int, int] | None = None
    flip: bool = False

    def __bool__(self) -> bool:
        return self.flip or self.crop is not None

    def __call__(self, pixels: Tensor) -> Tensor:
        """Stacks uint8 (B, K, H, W, 3) to (B, K, h, w, 3)."""
        b, _, H, W, _ = pixels.shape
        h, w = self.crop or (H, W)
        rows = torch.randint(H - h + 1, (b, 1)) + torch.arange(h)
        columns = torch.randint(W - w + 1, (b, 1)) + torch.arange(w)
        if self.flip:
            columns = torch.where(torch.rand(b, 1) < 0.5, columns.flip(1), columns)
        rows, columns = rows.to(pixels.device)[:, :, None], columns.to(pixels.device)[:, None]
        image = torch.arange(b, device=pixels.device)[:, None, None]
        return pixels[image, :, rows, columns].movedim(3, 1)  # indexing gave (B, h, w, K, 3)

"""A history of generated images for the discriminators (Shrivastava et al. 2017)."""

from __future__ import annotations

import torch
from torch import Tensor


class ImagePool:
    """Keeps ``size`` past images; half of what is asked for comes from the past. Size 0 passes through."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.images: list[Tensor] = []

    def __call__(self, images: Tensor) -> Tensor:
        """Swap in past images with probability 1/2. Shape (B, C, H, W) in and out."""
        out = []
        for image in images.detach() if self.size else ():
            if len(self.images) < self.size:
                self.images.append(image)
                out.append(image)
            elif torch.rand(()) < 0.5:
                i = int(torch.randint(self.size, ()))
                out.append(self.images[i])
                self.images[i] = image
            else:
                out.append(image)
        return torch.stack(out) if out else images.detach()

"""How images of any size get to the one size that a network takes, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from PIL import Image

Fit = Literal["resize", "pad", "crop"]
STRIDE = 4
"""The generator halves images twice, so their sides are multiples of this."""


def scaled(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """An image uint8 (H, W, 3) resampled to uint8 (height, width, 3), with antialiasing."""
    if image.shape[:2] == (height, width):
        return image
    return np.array(Image.fromarray(image).resize((width, height), Image.Resampling.BICUBIC))


@dataclass(frozen=True)
class Fitted:
    """A size, multiples of 4, and how images get there.

    Args:
        height: pixels.
        width: pixels.
        how: ``resize`` (the shape may change a little), ``pad`` (shrunk if it must be, then its edges repeated) or
            ``crop`` (scaled to cover the size, the middle kept).
    """

    height: int
    width: int
    how: Fit = "resize"

    @classmethod
    def nearest(cls, height: int, width: int, how: Fit) -> Fitted:
        """The size nearest to an image's that G takes; not smaller with ``pad``, not larger with ``crop``."""
        offset = {"resize": STRIDE // 2, "pad": STRIDE - 1, "crop": 0}[how]
        height, width = (max(STRIDE, (side + offset) // STRIDE * STRIDE) for side in (height, width))
        return cls(height, width, how)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """An image uint8 (h, w, 3) at this size."""
        h, w = image.shape[:2]
        if (h, w) == (self.height, self.width):
            return image
        if self.how == "resize":
            return scaled(image, self.height, self.width)
        if self.how == "pad":
            inner = scaled(image, *self.inside(h, w))
            return np.pad(inner, (*self.margins(*inner.shape[:2]), (0, 0)), mode="edge")
        scale = max(self.height / h, self.width / w)
        image = scaled(image, max(self.height, round(h * scale)), max(self.width, round(w * scale)))
        top, left = (image.shape[0] - self.height) // 2, (image.shape[1] - self.width) // 2
        return image[top : top + self.height, left : left + self.width]

    def undo(self, image: np.ndarray, height: int, width: int) -> np.ndarray:
        """A fitted image uint8 (H, W, 3) back at the height and width it came with; what was cropped stays away."""
        if self.how == "crop":
            return image
        if self.how == "pad":
            h, w = self.inside(height, width)
            (top, _), (left, _) = self.margins(h, w)
            image = image[top : top + h, left : left + w]
        return scaled(image, height, width)

    def inside(self, h: int, w: int) -> tuple[int, int]:
        """Height and width after shrinking to fit inside; smaller images stay as they are."""
        scale = min(1.0, self.height / h, self.width / w)
        return min(self.height, max(1, round(h * scale))), min(self.width, max(1, round(w * scale)))

    def margins(self, h: int, w: int) -> tuple[tuple[int, int], tuple[int, int]]:
        """Rows above and below, columns left and right, that are missing."""
        rows, columns = self.height - h, self.width - w
        return (rows // 2, rows - rows // 2), (columns // 2, columns - columns // 2)

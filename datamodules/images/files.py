"""Image files: which there are, and each as RGB bytes or a plain error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".gif", ".webp", ".tif", ".tiff", ".ppm", ".pgm"}
"""Files below a folder that are taken for images, by how their names end."""


class ImageError(ValueError):
    """An image, a folder of them or their labels are not what they should be; the message says which."""


def list_images(folder: Path) -> list[Path]:
    """All image files below a folder, sorted by path; hidden ones are left out.

    Raises:
        ImageError: if there is no such folder, or no image in it.
    """
    if not folder.is_dir():
        raise ImageError(f"{folder}: no such folder; expected a folder with images")
    hidden = lambda path: any(part.startswith(".") for part in path.relative_to(folder).parts)  # noqa: E731
    found = [p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file() and not hidden(p)]
    if not found:
        raise ImageError(f"{folder}: holds no images; expected files that end in {', '.join(sorted(IMAGE_SUFFIXES))}")
    return sorted(found)


def read_image(path: Path) -> np.ndarray:
    """An image file as uint8 (H, W, 3), upright; of animations the first frame.

    Raises:
        ImageError: if the file is empty, cut short or no image.
    """
    if path.stat().st_size == 0:
        raise ImageError(f"{path}: is empty (0 bytes)")
    try:
        with Image.open(path) as image:
            image.load()
            return to_rgb(ImageOps.exif_transpose(image))
    except UnidentifiedImageError:
        raise ImageError(f"{path}: is no image that can be read") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ImageError(f"{path}: cannot be read ({str(error).rstrip('.')})") from None


def to_rgb(image: Image.Image) -> np.ndarray:
    """uint8 (H, W, 3): grey is repeated, 16 bits are scaled to 8, what is transparent becomes white."""
    if image.mode.startswith("I"):  # Pillow would clip 16 bits, not scale them
        grey = np.asarray(image).astype(np.int64)
        image = Image.fromarray((grey >> 8 if grey.max() > 255 else grey).clip(0, 255).astype(np.uint8))
    if "A" in image.mode or "transparency" in image.info:
        image = image.convert("RGBA")
        white = Image.new("RGBA", image.size, (255, 255, 255, 255))
        image = Image.alpha_composite(white, image)
    return np.array(image.convert("RGB"))

"""Still images, as stacks of one frame."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch.utils.data import Dataset
from torchvision.transforms.functional import to_pil_image
from tqdm import tqdm

from datamodules.images.files import ImageError, list_images, read_image, to_rgb
from datamodules.images.fitting import Fit, Fitted
from datamodules.images.labels import read_labels

log = logging.getLogger(__name__)
OnBad = Literal["error", "skip"]


@dataclass(frozen=True)
class Reading:
    """How images are read.

    Args:
        size: what images are brought to; None takes the nearest to their own, which must then be one.
        how: see :class:`datamodules.images.fitting.Fitted`.
        on_bad: what to do about images that cannot be read: ``error``, or ``skip`` them with a warning.
        cache: keep the decoded images in memory; else each is decoded whenever it is needed.
        bar: show a progress bar.
    """

    size: tuple[int, int] | None = None
    how: Fit = "resize"
    on_bad: OnBad = "error"
    cache: bool = True
    bar: bool = False

    def fit(self, shape: Sequence[int]) -> Fitted:
        """The size, given that of an image."""
        height, width = self.size or shape[:2]
        return Fitted(height, width, self.how) if self.size else Fitted.nearest(height, width, self.how)


class StillImages(Dataset):
    """Images by name, at one size; batches as :class:`datamodules.stacks.FrameStacks` gives them, with K = 1.

    Args:
        names: of the images.
        read: an image uint8 (h, w, 3) by its number.
        reading: how.
        labels: states float32 (n, s), or None.

    Attributes:
        sizes: height and width that each image came with.
        bad: what is wrong with those that were left out.

    Raises:
        ImageError: if images cannot be read, or differ in size and none is chosen.
    """

    frame_stack = 1

    def __init__(self, names: Sequence[str], read: Callable[[int], np.ndarray], reading: Reading, where: str) -> None:
        self.read, self.where = read, where
        self.labels: np.ndarray | None = None
        self.fit = reading.fit(first_image(read, len(names)).shape)
        with ThreadPoolExecutor() as pool:  # decoding releases the interpreter's lock
            look = pool.map(partial(self.attempt, keep=reading.cache), range(len(names)))
            looked = list(tqdm(look, where, len(names), disable=not reading.bar, leave=False))
        bad = [found for found in looked if isinstance(found, ImageError)]
        report_bad(where, bad, len(names), reading.on_bad)
        self.number = [i for i, found in enumerate(looked) if not isinstance(found, ImageError)]
        self.names = [names[i] for i in self.number]
        self.sizes = [looked[i][0] for i in self.number]
        self.frames = np.stack([looked[i][1] for i in self.number]) if reading.cache else None
        if reading.size is None:
            self.check_one_size()

    def __len__(self) -> int:
        return len(self.names)

    def attempt(self, i: int, keep: bool) -> tuple[tuple[int, int], np.ndarray | None] | ImageError:
        """An image's own size and, to keep, the image at the common size; or what is wrong with it."""
        try:
            image = self.read(i)
        except ImageError as error:
            return error
        return image.shape[:2], self.fit(image) if keep else None

    def check_one_size(self) -> None:
        """That all images came with the same size.

        Raises:
            ImageError: naming two that differ.
        """
        for name, (h, w) in zip(self.names, self.sizes, strict=True):
            if (h, w) != self.sizes[0]:
                (h0, w0), first = self.sizes[0], self.names[0]
                both = Fitted.nearest(min(h0, h), min(w0, w), self.fit.how)
                raise ImageError(
                    f"{self.where}: images differ in size: {first} is {h0}x{w0} and {name} {h}x{w} (height x width). "
                    f"Choose one size for all with --data.size, for example --data.size [{both.height},{both.width}]"
                )

    def stacks(self, index: Sequence[int]) -> np.ndarray:
        """Images as stacks of one: uint8 (n, 1, H, W, 3)."""
        if self.frames is not None:
            return self.frames[np.asarray(index)][:, None]
        return np.stack([self.fit(self.read(self.number[i])) for i in index])[:, None]

    def __getitems__(self, index: list[int]) -> dict[str, torch.Tensor]:
        """A batch at once: ``pixels``, ``index`` and, where there are labels, ``state``."""
        batch = {"pixels": torch.from_numpy(self.stacks(index)), "index": torch.tensor(index)}
        if self.labels is not None:
            batch["state"] = torch.from_numpy(self.labels[np.asarray(index)])
        return batch

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        return {name: value[0] for name, value in self.__getitems__([index]).items()}


def first_image(read: Callable[[int], np.ndarray], n: int) -> np.ndarray:
    """The first of ``n`` images that can be read, uint8 (h, w, 3).

    Raises:
        ImageError: if there is none; what is wrong with the last.
    """
    for i in range(n):
        try:
            return read(i)
        except ImageError:
            if i == n - 1:
                raise
    raise ImageError("there are no images")


def report_bad(where: str, bad: Sequence[ImageError], n: int, on_bad: OnBad) -> None:
    """Raise or warn about images that cannot be read.

    Args:
        where: where they are, for the message.
        bad: what is wrong with each of them.
        n: number of all images there.
        on_bad: which of the two.

    Raises:
        ImageError: that tells of the first five; with ``on_bad="error"``.
    """
    if not bad:
        return
    few = "; ".join(str(e) for e in bad[:5]) + (f"; and {len(bad) - 5} more" if len(bad) > 5 else "")
    told = f"{where}: {len(bad)} of {n} images cannot be read: {few}"
    if on_bad == "error":
        raise ImageError(f"{told}. Mend or delete them, or leave them out with --data.on_bad skip.")
    log.warning("%s. They are left out.", told)


def from_folder(folder: Path, reading: Reading, labels: Path | None = None) -> StillImages:
    """The images below a folder, named by their paths in it.

    Args:
        folder: of the images.
        reading: how they are read.
        labels: file with their states (:func:`datamodules.images.labels.read_labels`), or None.

    Raises:
        ImageError: naming the image, the folder or the file of labels, and what is wrong with it.
    """
    files = list_images(folder)
    names = [f.relative_to(folder).as_posix() for f in files]
    images = StillImages(names, partial(read_numbered, files), reading, str(folder))
    if labels is not None:
        images.labels = read_labels(labels, images.names)
    return images


def from_dataset(dataset: Dataset, reading: Reading) -> StillImages:
    """The images of a torchvision dataset (or any that gives an image, or a tuple that begins with one)."""
    names = [f"{i:06d}.png" for i in range(len(dataset))]
    return StillImages(names, partial(read_item, dataset), reading, type(dataset).__name__)


def read_numbered(files: Sequence[Path], i: int) -> np.ndarray:
    """An image of a list of files."""
    return read_image(files[i])


def read_item(dataset: Dataset, i: int) -> np.ndarray:
    """An image of a dataset, uint8 (h, w, 3)."""
    item = dataset[i]
    image = item[0] if isinstance(item, tuple | list) else item
    return to_rgb(to_pil_image(image) if isinstance(image, torch.Tensor | np.ndarray) else image)

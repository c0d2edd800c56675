"""Two domains of images to translate between: folders, trajectory files or torchvision datasets."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Any, Literal, TypeAlias

import lightning as L
import torch
from lightning.pytorch.utilities import CombinedLoader
from torch.utils.data import DataLoader, Dataset

from datamodules.epoch_order import EpochOrder
from datamodules.images.augmentation import Augmentation
from datamodules.images.files import ImageError
from datamodules.images.fitting import STRIDE, Fit
from datamodules.images.frames import TrajectoryImages
from datamodules.images.still import OnBad, Reading, StillImages, from_dataset, from_folder
from datamodules.stacks import whole_batch

log = logging.getLogger(__name__)
Where: TypeAlias = str | list[str] | Dataset | None
Images = StillImages | TrajectoryImages
ROOT = {"source": "trainA", "target": "trainB", "test_source": "testA", "test_target": "testB"}
"""Folders below ``root``, as CycleGAN's datasets name them."""


class ImageDomains(L.LightningDataModule):
    """Unpaired images of a source and a target; one epoch is one pass over the larger of the two.

    A place is a folder of images, one or several trajectory files (``.h5``), or a torchvision dataset (``class_path``).
    Batches: ``{"source": {"pixels", "index", "state" if labelled}, "target": {"pixels", "index"}}``, pixels uint8
    (B, K, H, W, 3), augmented on the device.

    Args:
        root: folder with trainA and trainB, and testA and testB if there are any; instead of the places below.
        source: place of the source images (A).
        target: place of the target images (B).
        test_source: place of the source images that ``validate`` and ``test`` use.
        test_target: likewise of the target.
        predict: place of the images that ``predict`` translates; default the source's test images.
        predict_domain: what those are; images of the target are translated back.
        labels: states of the source images in a folder, as CSV, NPZ or HDF5; trajectory files hold their own.
        test_labels: states of the source's test images.
        paired: the test images of both domains belong together, one by one, in order of their names.
        size: height and width that images are brought to, multiples of 4, pixels; default their own size, to the next
            multiples of 4.
        fit: how they get there: resize, pad (repeats the edges), crop (keeps the middle).
        frame_stack: K frames in an observation; folders and torchvision datasets have 1.
        batch_size: stacks of each domain in a batch.
        augment: random crops and flips in training.
        workers: processes that load data; 0 where all images are in memory.
        cache: keep all images decoded in memory; else they are decoded when needed (then choose ``workers``).
        on_bad: what to do about images that cannot be read: error, or skip them with a warning.

    Raises:
        ImageError: if a size is no multiple of 4, or ``root`` is no folder.
    """

    def __init__(
        self,
        root: str | None = None,
        source: Where = None,
        target: Where = None,
        test_source: Where = None,
        test_target: Where = None,
        predict: Where = None,
        predict_domain: Literal["source", "target"] = "source",
        labels: str | None = None,
        test_labels: str | None = None,
        paired: bool = False,
        size: tuple[int, int] | None = None,
        fit: Fit = "resize",
        frame_stack: int = 1,
        batch_size: int = 1,
        augment: Augmentation = Augmentation(),
        workers: int = 0,
        cache: bool = True,
        on_bad: OnBad = "error",
    ) -> None:
        super().__init__()
        self.places = {"source": source, "target": target, "test_source": test_source, "test_target": test_target}
        self.places |= {"predict": predict}
        self.labels = {"source": labels, "test_source": test_labels}
        self.root, self.predict_domain, self.paired, self.augment = root, predict_domain, paired, augment
        self.frame_stack, self.batch_size, self.workers = frame_stack, batch_size, workers
        self.reading = Reading(size, fit, on_bad, cache, sys.stderr.isatty())
        self.images: dict[str, Images] = {}
        self.seed = torch.initial_seed()
        for what, chosen in (("data.size", size), ("data.augment.crop", augment.crop)):
            if chosen and any(side < STRIDE or side % STRIDE for side in chosen):
                raise ImageError(f"{what}: height and width must be multiples of {STRIDE}, got {list(chosen)}")
        if root is not None:
            self.look_below(Path(root))

    def look_below(self, root: Path) -> None:
        """Take the places that are not given from CycleGAN's folder names.

        Raises:
            ImageError: if there is no such folder.
        """
        if not root.is_dir():
            raise ImageError(f"{root}: no such folder; data.root must hold {', '.join(ROOT.values())}")
        for what, name in ROOT.items():
            if self.places[what] is None and (root / name).is_dir():
                self.places[what] = str(root / name)

    def load(self, what: str) -> Images:
        """The images of a place (``"source"``, ``"test_target"``, ...), read once; see :meth:`read`."""
        if what not in self.images:
            self.images[what] = self.read(what)
        return self.images[what]

    def read(self, what: str) -> Images:
        """The images of a place.

        Raises:
            ImageError: naming the place and what is wrong with it.
        """
        where = self.places[what]
        if where is None or where == []:
            below = f" (or {ROOT[what]} in data.root{': ' + self.root if self.root else ''})" if what in ROOT else ""
            raise ImageError(f"data.{what}{below} is needed: a folder of images, a trajectory file, or a dataset")
        if isinstance(where, Dataset):
            return from_dataset(where, self.reading)
        paths = [where] if isinstance(where, str) else where
        if all(Path(p).suffix in (".h5", ".hdf5") for p in paths):
            return TrajectoryImages(paths, self.frame_stack, self.reading, labelled="target" not in what)
        if len(paths) > 1 or not Path(paths[0]).is_dir():
            raise ImageError(f"data.{what}: {paths[0]} is neither a folder nor a trajectory file (.h5)")
        labels = self.labels.get(what)
        return from_folder(Path(paths[0]), self.reading, Path(labels) if labels else None)

    def setup(self, stage: str) -> None:
        """Read what a stage of the Trainer needs.

        Raises:
            ImageError: naming the place and what is wrong with it, or the two that do not go together.
        """
        wanted = {"fit": ["source", "target"], "predict": [self.predicted]}.get(stage, [])
        if stage in ("validate", "test") or (stage == "fit" and self.has_tests):
            wanted += ["test_source", "test_target"]
        for what in wanted:
            self.load(what)
        if stage == "fit":
            self.check_training_images()
        if "test_source" in wanted and self.paired and len(self.load("test_source")) != len(self.load("test_target")):
            raise ImageError(
                f"data.paired: there are {len(self.load('test_source'))} source and {len(self.load('test_target'))} "
                "target test images; pairs need as many of both"
            )

    def check_training_images(self) -> None:
        """That source and target can be trained on together.

        Raises:
            ImageError: saying what differs, or how many images are too few.
        """
        source, target = self.load("source"), self.load("target")
        for what, images in (("source", source), ("target", target)):
            needed = max(2, self.batch_size)
            if len(images) < needed:
                raise ImageError(
                    f"{images.where}: the {what} has {len(images)} image{'s' * (len(images) != 1)}; training needs "
                    f"at least {needed} (data.batch_size is {self.batch_size}), and hundreds are usual"
                )
        if source.fit != target.fit:
            sizes = [f"{im.where} has {im.sizes[0][0]}x{im.sizes[0][1]}" for im in (source, target)]
            raise ImageError(f"source and target images differ in size: {'; '.join(sizes)}. Choose one: --data.size")
        if self.frame_stack != source.frame_stack or self.frame_stack != target.frame_stack:
            raise ImageError(f"data.frame_stack is {self.frame_stack}, but single images have no other frames: use 1")
        if source.labels is not None and self.augment:
            raise ImageError("data.augment moves what the labels tell the place of: leave it out, or leave out labels")
        crop = self.augment.crop or (0, 0)
        if crop[0] > source.fit.height or crop[1] > source.fit.width:
            size = f"{source.fit.height}x{source.fit.width}"
            raise ImageError(f"data.augment.crop {list(crop)} is larger than the images, which are {size}")

    @property
    def has_tests(self) -> bool:
        """Whether there are test images of both domains."""
        return self.places["test_source"] is not None and self.places["test_target"] is not None

    @property
    def predicted(self) -> str:
        """The place that ``predict`` takes images from."""
        options = ("predict", f"test_{self.predict_domain}", self.predict_domain)
        return next((what for what in options if self.places[what] is not None), "predict")

    @property
    def dimensions(self) -> dict[str, Any]:
        """What the module's constructor takes of training images: ``state_dim``, ``image_size``, ``frame_stack``."""
        self.setup("fit")
        source = self.load("source")
        size = self.augment.crop or (source.fit.height, source.fit.width)
        state_dim = 0 if source.labels is None else source.labels.shape[1]
        return {"state_dim": state_dim, "image_size": list(size), "frame_stack": self.frame_stack}

    def loader(self, what: str, train: bool) -> DataLoader:
        """Batches of a place: shuffled and whole in training, else in order."""
        images, epoch = self.load(what), 0 if self.trainer is None else self.trainer.current_epoch
        return DataLoader(
            images,
            batch_size=self.batch_size,
            sampler=EpochOrder(len(images), self.seed + (what == "target"), epoch) if train else None,
            drop_last=train,
            collate_fn=whole_batch,
            generator=torch.Generator().manual_seed(self.seed + epoch),  # else it draws from everybody's numbers
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            pin_memory=self.trainer is not None and self.trainer.strategy.root_device.type == "cuda",
        )

    def train_dataloader(self) -> CombinedLoader:
        return CombinedLoader({d: self.loader(d, train=True) for d in ("source", "target")}, "max_size_cycle")

    def val_dataloader(self) -> CombinedLoader | list:
        if self.trainer.state.fn == "fit" and not self.has_tests:
            return []
        return CombinedLoader({d: self.loader(f"test_{d}", train=False) for d in ("source", "target")}, "max_size")

    test_dataloader = val_dataloader

    def predict_dataloader(self) -> DataLoader:
        return self.loader(self.predicted, train=False)

    def on_after_batch_transfer(self, batch: dict, dataloader_idx: int) -> dict:
        if self.trainer.predicting:
            return {self.predict_domain: batch}
        if not self.trainer.training or not self.augment:
            return batch
        return {domain: part | {"pixels": self.augment(part["pixels"])} for domain, part in batch.items()}

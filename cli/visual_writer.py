"""Writes what `idapt visual predict` translates: an image file each, or a trajectory file."""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import lightning as L
import numpy as np
from lightning.pytorch.callbacks import BasePredictionWriter
from torch import Tensor

from cli.arguments import keep_inputs
from datamodules import Trajectories, write_trajectories
from datamodules.images import StillImages, TrajectoryImages
from idapt_pl.files import write_atomically

log = logging.getLogger(__name__)


class TranslationWriter(BasePredictionWriter):
    """Writes translated images, each at the size its original came with.

    Images of a folder keep their names and folders and become PNG files. Observations of a trajectory file become a
    trajectory file with the same actions, states and rewards, whose images are translated.

    Args:
        out: folder for images, or trajectory file (``.h5``).
    """

    def __init__(self, out: str = "translated") -> None:
        super().__init__("batch")
        self.out = Path(out)
        self.frames: dict[int, np.ndarray] = {}

    def on_predict_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        images = predicted(trainer)
        if isinstance(images, TrajectoryImages) != (self.out.suffix in (".h5", ".hdf5")):
            wanted = "a trajectory file (.h5)" if isinstance(images, TrajectoryImages) else "a folder"
            raise ValueError(f"predictions.out is {self.out}, but {images.where} becomes {wanted}")
        places = trainer.datamodule.places[trainer.datamodule.predicted]
        keep_inputs(self.out, [places] if isinstance(places, str) else places if isinstance(places, list) else [])
        if isinstance(images, StillImages):
            check_distinct([Path(name).with_suffix(".png") for name in images.names], images.where)
        if isinstance(images, TrajectoryImages) and trainer.world_size > 1:
            raise ValueError("a trajectory file is written by one process: use --trainer.devices 1")

    def write_on_batch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        prediction: Tensor,
        batch_indices: Any,
        batch: dict,
        batch_idx: int,
        dataloader_idx: int,
    ) -> None:
        """Write a batch's images, or keep its newest frames for the trajectory file."""
        images = predicted(trainer)
        (part,) = batch.values()
        for i, frame in zip(part["index"].tolist(), prediction[:, -1].cpu().numpy(), strict=True):
            frame = images.fit.undo(frame, *images.sizes[i])
            if isinstance(images, StillImages):
                path = (self.out / images.names[i]).with_suffix(".png")
                write_atomically(path, partial(iio.imwrite, image=frame, extension=".png"))
            else:
                self.frames[i] = frame

    def on_predict_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        images = predicted(trainer)
        if isinstance(images, TrajectoryImages):
            write_trajectories(self.out, translated(images, self.frames))
        log.info("%d images of %s translated -> %s", len(images), images.where, self.out)


def check_distinct(written: list[Path], where: object) -> None:
    """Refuse images whose translations would have one name.

    Raises:
        ValueError: naming it.
    """
    twice = next((str(path) for path, n in Counter(written).items() if n > 1), None)
    if twice:
        raise ValueError(f"{where} has several images whose translations would all be {twice}: rename them")


def predicted(trainer: L.Trainer) -> StillImages | TrajectoryImages:
    """The images that are being translated."""
    return trainer.datamodule.load(trainer.datamodule.predicted)


def translated(images: TrajectoryImages, frames: dict[int, np.ndarray]) -> Trajectories:
    """The trajectories with other images, by number of observation."""
    episodes, first = [], 0
    for episode in images.trajectories:
        pixels = np.stack([frames[first + t] for t in range(len(episode) + 1)])
        episodes.append(replace(episode, observations=episode.observations | {"pixels": pixels}))
        first += len(episode) + 1
    old = images.trajectories
    return Trajectories(tuple(episodes), old.dt, f"translated by G from {old.source or images.where}")

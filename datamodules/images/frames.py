"""Images of trajectory files, as stacks of frames, at one size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from datamodules.images.still import Reading
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all


class TrajectoryImages(FrameStacks):
    """Frame stacks of trajectory files; batches have the observations' ``index`` as well.

    Args:
        paths: trajectory files, of images of one size.
        frame_stack: K.
        reading: how.
        labelled: also give ``state``, where the files have it.
    """

    def __init__(self, paths: Sequence[Path | str], frame_stack: int, reading: Reading, labelled: bool = True) -> None:
        self.trajectories, self.frame_stack = read_all(paths), frame_stack
        self.where = ", ".join(map(str, paths))
        labelled = labelled and all("state" in e.observations for e in self.trajectories)
        super().__init__(self.trajectories, frame_stack, "state" if labelled else None)
        self.sizes = [self.frames.shape[1:3]] * len(self.frames)
        self.fit = reading.fit(self.frames.shape[1:])
        if self.frames.shape[1:3] != (self.fit.height, self.fit.width):
            self.frames = np.stack([self.fit(frame) for frame in self.frames])

    def __getitems__(self, index: list[int] | np.ndarray) -> dict[str, torch.Tensor]:
        return super().__getitems__(index) | {"index": torch.tensor(index)}

"""Frame stacks out of trajectories: the one place that knows where episodes begin."""

from __future__ import annotations

import numpy as np
import torch
from torch.utils.data import Dataset

from datamodules.trajectories import Trajectories


class FrameStacks(Dataset):
    """All observations of some trajectories as stacks of K frames, read in whole batches.

    Frames are kept once, in memory, as uint8; a stack is an index into them, and never reaches back
    past the first frame of its episode (that frame is repeated instead, as an environment does).

    Args:
        trajectories: with ``pixels``.
        frame_stack: K.
        labels: name of another observation to give along as float32, for example ``"state"``, or None.
    """

    def __init__(self, trajectories: Trajectories, frame_stack: int, labels: str | None = None) -> None:
        self.frames = np.concatenate([e.observations["pixels"] for e in trajectories])
        self.labels: np.ndarray | None = None
        if labels is not None:
            self.labels = np.concatenate([e.observations[labels] for e in trajectories]).astype(np.float32)
        lengths = np.array([len(e) + 1 for e in trajectories])
        starts = np.repeat(np.cumsum(lengths) - lengths, lengths)
        self._lags = np.arange(1 - frame_stack, 1)
        self.first = starts  # index of the first frame of each observation's episode
        ends = np.cumsum(lengths) - 1
        self.transitions = np.setdiff1d(np.arange(len(self.frames)), ends)  # t whose t+1 is the same episode
        self.actions = np.concatenate([e.actions for e in trajectories]).astype(np.float32)

    def __len__(self) -> int:
        return len(self.frames)

    def stacks(self, index: np.ndarray) -> np.ndarray:
        """Stacks at some observations: uint8 (n, K, H, W, 3), oldest frame first."""
        index = np.asarray(index)
        return self.frames[np.maximum(index[:, None] + self._lags, self.first[index][:, None])]

    def __getitems__(self, index: list[int] | np.ndarray) -> dict[str, torch.Tensor]:
        """A batch at once: ``pixels`` and, where asked for, ``state``."""
        batch = {"pixels": torch.from_numpy(self.stacks(np.asarray(index)))}
        if self.labels is not None:
            batch["state"] = torch.from_numpy(self.labels[index])
        return batch

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        return {name: value[0] for name, value in self.__getitems__([index]).items()}


class FirstObservations(Dataset):
    """The first observation of each episode, out of some frame stacks."""

    def __init__(self, stacks: FrameStacks) -> None:
        self.of, self.index = stacks, np.unique(stacks.first)

    def __len__(self) -> int:
        return len(self.index)

    def __getitems__(self, index: list[int]) -> dict[str, torch.Tensor]:
        """As for the frame stacks."""
        return self.of.__getitems__(self.index[np.asarray(index)])


def whole_batch(batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Collate function for datasets whose ``__getitems__`` already returns a batch."""
    return batch

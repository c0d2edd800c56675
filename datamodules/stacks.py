"""Frame stacks out of trajectories: the one place that knows where episodes begin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch.utils.data import Dataset

from datamodules.trajectories import Episode, Trajectories


class FrameStacks(Dataset):
    """All observations of some trajectories as stacks of K frames, read in whole batches.

    Frames are kept once, in memory, as uint8; a stack is an index into them, and never reaches back
    past the first frame of its episode (that frame is repeated instead, as an environment does).

    Args:
        trajectories: episodes with ``pixels``.
        frame_stack: K.
        labels: name of another observation to give along as float32, for example ``"state"``, or None.
    """

    def __init__(
        self, trajectories: Trajectories | Sequence[Episode], frame_stack: int, labels: str | None = None
    ) -> None:
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

    def episodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Index of each episode's first observation, and how many it has: int (E,), int (E,)."""
        return np.unique(self.first, return_counts=True)

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


class PlayedAgain(Dataset):
    """Observations of recordings, or of the same actions played again elsewhere, of equal numbers of steps.

    Item i of the one and item i of the other belong together: so many control steps after the start of an episode.

    Args:
        these: frame stacks that are given.
        others: of the same number of episodes. Steps that only one of the two has are left out.
    """

    def __init__(self, these: FrameStacks, others: FrameStacks) -> None:
        (starts, lengths), (_, of_others) = these.episodes(), others.episodes()
        assert len(lengths) == len(of_others)
        common = np.minimum(lengths, of_others)
        steps = np.arange(common.sum()) - np.repeat(np.cumsum(common) - common, common)
        self.of, self.index = these, np.repeat(starts, common) + steps

    def __len__(self) -> int:
        return len(self.index)

    def __getitems__(self, index: list[int]) -> dict[str, torch.Tensor]:
        """As for the frame stacks."""
        return self.of.__getitems__(self.index[np.asarray(index)])


def whole_batch(batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Collate function for datasets whose ``__getitems__`` already returns a batch."""
    return batch

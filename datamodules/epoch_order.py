"""The order of an epoch's images, which depends on the epoch alone, so that a run that goes on has its order."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch.utils.data import Sampler


class EpochOrder(Sampler[int]):
    """A random order of a dataset, another one in every epoch and every pass within it.

    Args:
        length: of the dataset.
        seed: of all orders.
        epoch: the one to begin with; Lightning sets those that follow.
    """

    def __init__(self, length: int, seed: int, epoch: int = 0) -> None:
        self.length, self.seed, self.epoch, self.passes = length, seed, epoch, 0

    def __len__(self) -> int:
        return self.length

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch; the one that is running goes on."""
        if epoch != self.epoch:
            self.epoch, self.passes = epoch, 0

    def __iter__(self) -> Iterator[int]:
        place = (self.seed, self.epoch, self.passes)
        self.passes += 1
        generator = torch.Generator().manual_seed(hash(place) % 2**63)  # of integers: the same in every process
        yield from torch.randperm(self.length, generator=generator).tolist()

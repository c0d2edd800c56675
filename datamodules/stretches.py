"""Stretches of recordings for what learns over time: readings, the actions between them, and true states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import lightning as L
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset


@dataclass(frozen=True)
class ReadEpisode:
    """An episode as a sensor reads it.

    Attributes:
        readings: of every observation, float32 (T+1, s).
        actions: taken just before each of them, 0 before the first, float32 (T+1, nu).
        states: the true ones, float32 (T+1, s).
    """

    readings: np.ndarray
    actions: np.ndarray
    states: np.ndarray


class StretchDataModule(L.LightningDataModule):
    """Batches of stretches of one length, drawn from everywhere in proportion to the episodes' lengths.

    Half of them begin where their episode does. Where an episode ends sooner the last values stand, and ``there``,
    bool (b, t), says so.

    Args:
        episodes: to draw from.
        length: of a stretch, t observations.
        batch_size: b.
        batches: length of an epoch.
        seed: of what is drawn.
    """

    def __init__(self, episodes: Sequence[ReadEpisode], length: int, batch_size: int, batches: int, seed: int) -> None:
        super().__init__()
        self.length, self.batch_size, self.batches, self.seed = length, batch_size, batches, seed
        self.sizes = np.array([len(e.readings) for e in episodes])
        self.starts = np.cumsum(self.sizes) - self.sizes
        self.arrays = {
            name: torch.from_numpy(np.concatenate([getattr(e, name) for e in episodes]))
            for name in ("readings", "actions", "states")
        }

    def draw(self, rng: np.random.Generator) -> dict[str, torch.Tensor]:
        """A batch: ``readings``, ``actions``, ``states`` (b, t, ...), ``there`` (b, t)."""
        episode = rng.choice(len(self.sizes), self.batch_size, p=self.sizes / self.sizes.sum())
        first = rng.integers(0, np.maximum(1, self.sizes[episode] - self.length + 1))
        first[rng.random(self.batch_size) < 0.5] = 0
        at = first[:, None] + np.arange(self.length)
        there = at < self.sizes[episode][:, None]
        rows = self.starts[episode][:, None] + np.minimum(at, self.sizes[episode][:, None] - 1)
        return {name: values[rows] for name, values in self.arrays.items()} | {"there": torch.from_numpy(there)}

    def train_dataloader(self) -> DataLoader:
        return DataLoader(_Drawn(self), batch_size=None, num_workers=0)


class _Drawn(IterableDataset):
    def __init__(self, module: StretchDataModule) -> None:
        self.module = module

    def __len__(self) -> int:
        return self.module.batches

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        rng = np.random.default_rng(self.module.seed)
        for _ in range(self.module.batches):
            yield self.module.draw(rng)

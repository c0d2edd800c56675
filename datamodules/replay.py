"""Experience replay for SAC: a ring of transitions, refilled by acting while learning."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import lightning as L
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset

from datamodules.stacks import FrameStacks

Transitions = dict[str, np.ndarray]
TRANSITION = ("observation", "state", "actions", "rewards", "terminations", "next_observation", "next_state")


class TransitionSource(Protocol):
    """Acts in n simulations."""

    @property
    def recent_return(self) -> float:
        """Mean return of the newest episodes."""

    def __call__(self) -> Transitions:
        """Advance by one step; n transitions, an array of n rows for each name."""


class ReplayBuffer:
    """The newest ``capacity`` transitions, as arrays allocated once from the first batch added.

    Args:
        capacity: transitions kept.
        seed: of the sampling.
    """

    def __init__(self, capacity: int, seed: int) -> None:
        self.capacity, self.size, self._next = capacity, 0, 0
        self._arrays: Transitions = {}
        self._rng = np.random.default_rng(seed)

    def add(self, transitions: Transitions) -> None:
        """Append n transitions; each array has n rows."""
        if not self._arrays:
            self._arrays = {k: np.zeros((self.capacity, *v.shape[1:]), v.dtype) for k, v in transitions.items()}
        n = len(next(iter(transitions.values())))
        rows = (self._next + np.arange(n)) % self.capacity
        for name, array in self._arrays.items():
            array[rows] = transitions[name]
        self._next = int((self._next + n) % self.capacity)
        self.size = min(self.size + n, self.capacity)

    def sample(self, *shape: int, names: Sequence[str] | None = None) -> dict[str, torch.Tensor]:
        """Uniform with replacement; every tensor (or those of ``names``) has leading dimensions ``shape``.

        Raises:
            ValueError: if nothing was added yet.
        """
        if self.size == 0:
            raise ValueError("the replay buffer is empty: act in the environment before sampling")
        return self._at(self._rng.integers(self.size, size=shape), names)

    def sample_stretches(
        self, *shape: int, length: int, simulations: int, names: Sequence[str] | None = None
    ) -> dict[str, torch.Tensor]:
        """Transitions that follow one another in one simulation; leading dimensions ``shape`` and ``length``.

        They may be of several episodes.

        Args:
            shape: how many stretches.
            length: transitions in each.
            simulations: that act side by side; that many transitions were added at a time.
            names: of the arrays; None for all.

        Raises:
            ValueError: if there are fewer than that, or the capacity is no multiple of the simulations.
        """
        times = self.size // simulations
        if times < length or self.capacity % simulations:
            raise ValueError(
                f"stretches of {length} transitions of {simulations} simulations cannot be drawn from {self.size} in a "
                f"buffer of {self.capacity}"
            )
        begin = self._rng.integers(times - length + 1, size=shape)[..., None] + np.arange(length)
        oldest = self._next if self.size == self.capacity else 0
        return self._at(
            (oldest + begin * simulations + self._rng.integers(simulations, size=(*shape, 1))) % self.capacity, names
        )

    def random_rows(self, among: int, count: int) -> np.ndarray:
        """Indices of another array of ``among`` rows, drawn with replacement by this buffer's random numbers."""
        return self._rng.integers(among, size=count)

    def _at(self, rows: np.ndarray, names: Sequence[str] | None) -> dict[str, torch.Tensor]:
        return {name: torch.from_numpy(self._arrays[name][rows]) for name in names or self._arrays}


class _ActAndSample(IterableDataset):
    """Each item: act once, then draw the minibatches of the updates that follow."""

    def __init__(self, module: ReplayDataModule) -> None:
        self.module = module

    def __len__(self) -> int:  # with a length, Lightning fetches no batch ahead, so data are never stale
        return self.module.batches

    def __iter__(self) -> Iterator[dict[str, dict[str, torch.Tensor]]]:
        m = self.module
        for _ in range(m.batches):
            m.buffer.add(m.act())
            batch = {"transitions": m.minibatches()}
            if m.image_batches:
                batch["images"] = m.images()
            yield batch


class ReplayDataModule(L.LightningDataModule):
    """Feeds SAC: acting and sampling alternate, one environment step then ``updates_per_batch`` minibatches.

    Args:
        act: advances the environments by one step and returns their n transitions; has a ``recent_return``.
        buffer: filled with warm-up transitions by whoever made it.
        batch_size: transitions in a minibatch.
        updates_per_batch: minibatches in a batch; tensors are (updates_per_batch, batch_size, ...).
        batches: length of an epoch.
        image_batches: minibatches of images with states in a batch, 0 for none.
        image_batch_size: images in one of them.
        names: what a minibatch holds.
        stretch: transitions that follow one another in place of each, and simulations that act; None for single ones.
        labelled: half of the images come from here, not from the buffer; None for none.
    """

    def __init__(
        self,
        act: TransitionSource,
        buffer: ReplayBuffer,
        batch_size: int,
        updates_per_batch: int,
        batches: int,
        image_batches: int = 0,
        image_batch_size: int = 32,
        names: Sequence[str] = TRANSITION,
        stretch: tuple[int, int] | None = None,
        labelled: FrameStacks | None = None,
    ) -> None:
        super().__init__()
        self.stretch, self.labelled = stretch, labelled
        self.act, self.buffer, self.names = act, buffer, names
        self.image_batches, self.image_batch_size = image_batches, image_batch_size
        self.batch_size, self.updates_per_batch, self.batches = batch_size, updates_per_batch, batches

    def minibatches(self) -> dict[str, torch.Tensor]:
        """Those of one batch."""
        shape = (self.updates_per_batch, self.batch_size)
        if self.stretch is None:
            return self.buffer.sample(*shape, names=self.names)
        length, simulations = self.stretch
        return self.buffer.sample_stretches(*shape, length=length, simulations=simulations, names=self.names)

    def images(self) -> dict[str, torch.Tensor]:
        """Images with states of one batch, (image_batches, image_batch_size, ...)."""
        n, size, names = self.image_batches, self.image_batch_size, ("pixels", "state")
        if self.labelled is None:
            return self.buffer.sample(n, size, names=names)
        seen = self.buffer.sample(n, size - size // 2, names=names)
        given = self.labelled.__getitems__(self.buffer.random_rows(len(self.labelled), n * (size // 2)))
        return {k: torch.cat([v, given[k].unflatten(0, (n, size // 2))], dim=1) for k, v in seen.items()}

    def progress(self) -> dict[str, float]:
        """What acting has achieved, to be logged beside the losses."""
        return {"policy/episode_return": self.act.recent_return, "policy/transitions": float(self.buffer.size)}

    def train_dataloader(self) -> DataLoader:
        return DataLoader(_ActAndSample(self), batch_size=None, num_workers=0)

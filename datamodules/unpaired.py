"""Unpaired images of two domains, and labelled images of one, from trajectory files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from operator import add
from pathlib import Path

import lightning as L
import torch
from lightning.pytorch.utilities import CombinedLoader
from torch.utils.data import DataLoader, Dataset, RandomSampler

from datamodules.stacks import FirstObservations, FrameStacks, PlayedAgain, whole_batch
from datamodules.trajectories import Trajectories, TrajectoryFileError, read_trajectories


def read_all(paths: Sequence[Path | str], also: str | None = None) -> Trajectories:
    """The episodes of several trajectory files, in order.

    Args:
        paths: of the files, whose images are of one size.
        also: name of an observation that all must have beside images, or None.

    Raises:
        TrajectoryFileError: naming the file and what is missing, or the files whose images differ in size.
    """
    parts = [read_trajectories(p) for p in paths]
    sizes: dict[tuple[int, ...], Path | str] = {}
    for path, part in zip(paths, parts, strict=True):
        for i, episode in enumerate(part):
            for name in ("pixels", also):
                if name is not None and name not in episode.observations:
                    raise TrajectoryFileError(f"{path}: episode_{i}/observations/{name} is missing; it is needed here")
            sizes.setdefault(episode.observations["pixels"].shape[1:], path)
    if len(sizes) > 1:
        found = "; ".join(f"{p} has {h}x{w}" for (h, w, _), p in sizes.items())
        raise TrajectoryFileError(f"images must be of one size, but {found}. Collect again with one --image-size.")
    return reduce(add, parts)


def labelled_stacks(paths: Sequence[Path | str], frame_stack: int) -> FrameStacks | None:
    """Stacks of K frames with states, of trajectory files that have both; None of no files."""
    return FrameStacks(read_all(paths, also="state"), frame_stack, labels="state") if paths else None


def random_batches(dataset: Dataset, batch_size: int, batches: int, seed: int) -> DataLoader:
    """``batches`` random batches from a dataset, reshuffled at each pass over it, reproducible by ``seed``."""
    generator = torch.Generator().manual_seed(seed)
    sampler = RandomSampler(dataset, num_samples=batch_size * batches, generator=generator)
    return DataLoader(dataset, batch_size, sampler=sampler, collate_fn=whole_batch)


class LabelledImages(L.LightningDataModule):
    """Source frame stacks with their states, to fit the source state predictor P^S.

    Batches: ``pixels`` uint8 (B, K, H, W, 3), ``state`` float32 (B, state_dim).

    Args:
        source: trajectory files with states.
        frame_stack: K.
        batch_size: B.
        batches: length of an epoch.
        seed: of the order.
    """

    def __init__(self, source: Sequence[Path | str], frame_stack: int, batch_size: int, batches: int, seed: int):
        super().__init__()
        self.source, self.seed = [str(p) for p in source], seed
        self.frame_stack, self.batch_size, self.batches = frame_stack, batch_size, batches

    def setup(self, stage: str) -> None:
        self.data = FrameStacks(read_all(self.source, also="state"), self.frame_stack, labels="state")

    def train_dataloader(self) -> DataLoader:
        return random_batches(self.data, self.batch_size, self.batches, self.seed)


class UnpairedImages(L.LightningDataModule):
    """Frame stacks of source (with states) and target (without), each drawn on its own.

    Batches: ``{"source": {"pixels", "state"}, "target": {"pixels"}}``, and with ``resets`` as many first
    observations of episodes under ``"source_resets"`` and ``"target_resets"``, drawn on their own too. With
    ``replayed`` these are the observations of its episodes and of the target's after the same actions, drawn together.

    Args:
        source: trajectory files with states.
        target: trajectory files with images of the same size.
        frame_stack: K.
        batch_size: stacks of each domain in a batch.
        batches: length of an epoch.
        seed: of the order.
        resets: first observations of each domain in a batch, 0 for none.
        replayed: trajectory file of the source that has, for every episode of the target's files, what its first
            actions do there; or None.
    """

    def __init__(
        self,
        source: Sequence[Path | str],
        target: Sequence[Path | str],
        frame_stack: int,
        batch_size: int,
        batches: int,
        seed: int,
        resets: int = 0,
        replayed: Path | str | None = None,
    ) -> None:
        super().__init__()
        self.resets, self.replayed = resets, replayed
        self.source, self.target, self.seed = [str(p) for p in source], [str(p) for p in target], seed
        self.frame_stack, self.batch_size, self.batches = frame_stack, batch_size, batches

    def setup(self, stage: str) -> None:
        self.source_data = FrameStacks(read_all(self.source, also="state"), self.frame_stack, labels="state")
        self.target_data = FrameStacks(read_all(self.target), self.frame_stack)
        if self.source_data.frames.shape[1:] != self.target_data.frames.shape[1:]:
            s, t = self.source_data.frames.shape[1:3], self.target_data.frames.shape[1:3]
            raise TrajectoryFileError(
                f"source images are {s[0]}x{s[1]} ({self.source[0]}) and target images {t[0]}x{t[1]} "
                f"({self.target[0]}); they must have one size. Collect again with one --image-size."
            )

    def train_dataloader(self) -> CombinedLoader:
        loaders = {
            "source": random_batches(self.source_data, self.batch_size, self.batches, self.seed),
            "target": random_batches(self.target_data, self.batch_size, self.batches, self.seed + 1),
        }
        if self.resets:
            for name, data, seed in self.known_alike():
                loaders[f"{name}_resets"] = random_batches(data, self.resets, self.batches, seed)
        return CombinedLoader(loaders, "min_size")

    def known_alike(self) -> Iterator[tuple[str, Dataset, int]]:
        """Domain, its observations that look alike in both, and the seed of their order: one if they are pairs."""
        if self.replayed is None:
            yield "source", FirstObservations(self.source_data), self.seed + 2
            yield "target", FirstObservations(self.target_data), self.seed + 3
            return
        replayed = FrameStacks(read_all([self.replayed]), self.frame_stack)
        yield "source", PlayedAgain(replayed, self.target_data), self.seed + 2
        yield "target", PlayedAgain(self.target_data, replayed), self.seed + 2

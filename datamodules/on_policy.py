"""On-policy data for GARAT: each batch is a fresh rollout beside the target's transitions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import lightning as L
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset

from datamodules.pieces import held_out, pieces
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all

Rollout = dict[str, torch.Tensor]
Encode = Callable[[np.ndarray], torch.Tensor]
"""Pixels uint8 (n, K, H, W, 3) to features (n, d)."""


def encode_all(data: FrameStacks, encode: Encode, chunk: int = 256) -> torch.Tensor:
    """Features of every observation, (n, d), on the CPU; ``chunk`` observations are encoded at a time."""
    every = np.arange(len(data))
    return torch.cat([encode(data.stacks(part)).cpu() for part in np.array_split(every, len(every) // chunk + 1)])


def target_transitions(
    target: Sequence[Path | str], encode: Encode, frame_stack: int, hold_out: bool = False
) -> Rollout:
    """Transitions of several trajectory files; each file weighs the same.

    Args:
        target: trajectory files, the newest last.
        encode: f.
        frame_stack: K.
        hold_out: leave out the pieces of the last file that are held out (:mod:`datamodules.pieces`).

    Returns:
        As :func:`encode_transitions`, of all files; those of shorter files are repeated.

    Raises:
        TrajectoryFileError: naming a file that cannot be used.
    """
    stacks = [FrameStacks(read_all([p]), frame_stack) for p in target]
    files = [encode_transitions(data, encode) for data in stacks]
    if hold_out:
        kept = ~held_out(pieces(stacks[-1]))[stacks[-1].transitions]
        files[-1] = {name: values[torch.from_numpy(kept)] for name, values in files[-1].items()}
    longest = max(len(t["actions"]) for t in files)
    return {n: torch.cat([t[n][torch.arange(longest) % len(t[n])] for t in files]) for n in files[0]}


def encode_transitions(data: FrameStacks, encode: Encode, chunk: int = 256) -> Rollout:
    """Transitions (f(o_t), a_t, f(o_{t+1})) within episodes, never across the end of one.

    Returns:
        ``features`` (n, d), ``actions`` (n, nu), ``next_features`` (n, d).
    """
    features = encode_all(data, encode, chunk)
    now = torch.from_numpy(data.transitions)
    return {
        "features": features[now],
        "actions": torch.from_numpy(data.actions),
        "next_features": features[now + 1],
    }


class _Rollouts(IterableDataset):
    def __init__(self, module: OnPolicyDataModule) -> None:
        self.module = module

    def __len__(self) -> int:  # with a length, Lightning fetches no batch ahead: rollout k uses policy k
        return self.module.rollouts

    def __iter__(self) -> Iterator[dict[str, Rollout]]:
        for _ in range(self.module.rollouts):
            yield {"agent": self.module.collect(), "target": self.module.target_transitions}


class OnPolicyDataModule(L.LightningDataModule):
    """Feeds GARAT: one batch is one rollout of the current F, and all target transitions.

    Args:
        collect: rolls the grounded environment out with the current F.
        target_transitions: see :func:`target_transitions`.
        rollouts: length of an epoch.
    """

    def __init__(self, collect: Callable[[], Rollout], target_transitions: Rollout, rollouts: int) -> None:
        super().__init__()
        self.collect, self.target_transitions, self.rollouts = collect, target_transitions, rollouts

    def train_dataloader(self) -> DataLoader:
        return DataLoader(_Rollouts(self), batch_size=None, num_workers=0)

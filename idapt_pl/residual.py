"""How far the grounded source moves from how the target moves, by images and actions: no reward, no true state."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from datamodules.on_policy import encode_transitions
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.rollout import collect
from idapt_pl.worlds import Worlds


def energy_distance(x: Tensor, y: Tensor) -> float:
    """2 E|X-Y| - E|X-X'| - E|Y-Y'|, zero iff the distributions agree (Székely & Rizzo 2013, eq. 2)."""

    def within(z: Tensor) -> float:
        return float(torch.cdist(z, z).sum() / (len(z) * (len(z) - 1)))

    return 2 * float(torch.cdist(x, y).mean()) - within(x) - within(y)


def transitions(stacks: FrameStacks, F: ActionTransformation) -> Tensor:
    """Transitions (f, a, f') as F's discriminator sees them, standardised by the target's spread, (n, 2d + nu)."""
    return F.transition_input(encode_transitions(stacks, F.encode))


def grounded_stacks(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None, steps: int,
    seed: int,
) -> FrameStacks:  # fmt: skip
    """What a policy sees in the source seen through G and moved through F (None is the identity)."""
    with closing(worlds.grounded(1, G, F)) as env:
        return FrameStacks(collect(env, policy.act, steps, seed, ""), worlds.frame_stack)


def half(lengths: Sequence[int]) -> np.ndarray:
    """Which transitions of episodes with these lengths make up one of two halves, (n,) of bool."""
    if len(lengths) == 1:
        return np.arange(lengths[0]) < lengths[0] // 2
    return np.repeat(np.arange(len(lengths)) % 2 == 0, lengths)


def residual(
    worlds: Worlds,
    policy: AsymmetricSAC,
    G: VisualTransformation,
    F: ActionTransformation,
    target: Sequence[Path],
    seed: int,
) -> dict[str, float]:
    """How far grounded transitions (f, a, f') are from the target's, before F, after F, and the floor.

    Energy distance on standardised features. The floor is what sampling alone gives: the distance between every other
    episode of the target's and the rest, or between the halves of a single one. The target's images and actions are
    all it uses.
    """

    def grounded(transform: ActionTransformation | None) -> Tensor:
        return transitions(grounded_stacks(worlds, policy, G, transform, len(real), seed), F)

    trajectories = read_all(target)
    real = transitions(FrameStacks(trajectories, worlds.frame_stack), F)
    one_half = half([len(e) for e in trajectories])
    return {
        "before": round(energy_distance(grounded(None), real), 4),
        "after": round(energy_distance(grounded(F), real), 4),
        "noise_floor": round(energy_distance(real[one_half], real[~one_half]), 4),
    }

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

ROLLOUTS = 3
"""With each F. One alone says little: four of the same policy, without F, were 1.3, 1.4, 1.5 and 3.0 from the target on
HalfCheetah, where each is a single long episode."""


def energy_distance(x: Tensor, y: Tensor) -> float:
    """2 E|X-Y| - E|X-X'| - E|Y-Y'|, zero iff the distributions agree (Székely & Rizzo 2013, eq. 2)."""

    def within(z: Tensor) -> float:
        return float(torch.cdist(z, z).sum() / (len(z) * (len(z) - 1)))

    return 2 * float(torch.cdist(x, y).mean()) - within(x) - within(y)


def transitions(stacks: FrameStacks, F: ActionTransformation) -> Tensor:
    """Transitions (f, a, f') as F's discriminator sees them, standardised by the target's spread, (n, 2d + nu)."""
    return F.transition_input(encode_transitions(stacks, F.encode))


def grounded_rollouts(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None, steps: int,
    rollouts: int, seed: int,
) -> list[FrameStacks]:  # fmt: skip
    """What a policy sees in the source seen through G and moved through F (None is the identity), several times.

    Starts and the policy's draws are the same whatever F is.
    """
    with closing(worlds.grounded(1, G, F)) as env, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return [FrameStacks(collect(env, policy.act, steps, seed + i, ""), worlds.frame_stack) for i in range(rollouts)]


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

    Energy distance on standardised features: mean and standard deviation over rollouts as long as the target's. The
    floor is what sampling alone gives: the distance between every other episode of the target's and the rest, or
    between the halves of a single one. The target's images and actions are all it uses.
    """

    def distances(transform: ActionTransformation | None) -> np.ndarray:
        rollouts = grounded_rollouts(worlds, policy, G, transform, len(real), ROLLOUTS, seed)
        return np.array([energy_distance(transitions(r, F), real) for r in rollouts])

    trajectories = read_all(target)
    real = transitions(FrameStacks(trajectories, worlds.frame_stack), F)
    one_half = half([len(e) for e in trajectories])
    found = {"noise_floor": energy_distance(real[one_half], real[~one_half])}
    for name, transform in {"before": None, "after": F}.items():
        far = distances(transform)
        found |= {name: far.mean(), f"{name}_std": far.std(ddof=1)}
    return {name: round(float(value), 4) for name, value in found.items()}

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
from idapt_pl.estimation.energy import energy_distance
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.rl.collect import collect_each
from idapt_pl.rl.policy import Acting
from idapt_pl.worlds import Worlds

ROLLOUTS = 3
"""With each F. One alone says little where it is a single long episode (``results/residuals.csv``)."""


def standardised_transitions(stacks: FrameStacks, F: ActionTransformation) -> Tensor:
    """Transitions (f, a, f') as F's discriminator sees them, standardised by the target's spread, (n, 2d + nu)."""
    return F.transition_input(encode_transitions(stacks, F.encode))


def grounded_rollouts(
    worlds: Worlds, policy: AsymmetricSAC, G: VisualTransformation, F: ActionTransformation | None, steps: int,
    rollouts: int, seed: int,
) -> list[FrameStacks]:  # fmt: skip
    """What a policy sees in the source seen through G and moved through F (None is the identity), several times.

    They run side by side. Starts and the policy's draws are the same whatever F is.
    """
    with closing(worlds.grounded(rollouts, G, F)) as env, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        act = Acting(policy, worlds.target.mean_actions)  # as where it was recorded
        return [FrameStacks(played, worlds.frame_stack) for played in collect_each(env, act, steps, seed)]


def half_of_episodes(lengths: Sequence[int]) -> np.ndarray:
    """Which transitions of episodes with these lengths make up one of two halves, (n,) of bool."""
    if len(lengths) == 1:
        return np.arange(lengths[0]) < lengths[0] // 2
    return np.repeat(np.arange(len(lengths)) % 2 == 0, lengths)


def transition_distances(
    worlds: Worlds,
    policy: AsymmetricSAC,
    G: VisualTransformation,
    F: ActionTransformation,
    target: Sequence[Path],
    seed: int,
    rollouts: int = ROLLOUTS,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Energy distances of grounded transitions to the target's: before F, after F (one a rollout each), and the floor.

    Rollouts are as long as the target's recordings. The floor is what sampling alone gives: the distance between every
    other episode of the target's and the rest, or between the halves of a single one.
    """
    trajectories = read_all(target)
    real = standardised_transitions(FrameStacks(trajectories, worlds.frame_stack), F)

    def far(transform: ActionTransformation | None) -> np.ndarray:
        played = grounded_rollouts(worlds, policy, G, transform, len(real), rollouts, seed)
        return np.array([energy_distance(standardised_transitions(r, F), real) for r in played])

    one_half = half_of_episodes([len(e) for e in trajectories])
    return far(None), far(F), energy_distance(real[one_half], real[~one_half])


def transition_residual(
    worlds: Worlds,
    policy: AsymmetricSAC,
    G: VisualTransformation,
    F: ActionTransformation,
    target: Sequence[Path],
    seed: int,
) -> dict[str, float]:
    """How far grounded transitions (f, a, f') are from the target's, before F, after F, and the floor.

    Energy distance on standardised features: mean and standard deviation over rollouts
    (:func:`transition_distances`). The target's images and actions are all it uses.
    """
    before, after, floor = transition_distances(worlds, policy, G, F, target, seed)
    found = {"noise_floor": floor}
    for name, far in {"before": before, "after": after}.items():
        found |= {name: far.mean(), f"{name}_std": far.std(ddof=1)}
    return {name: round(float(value), 4) for name, value in found.items()}

"""States for real images of the target, where the source does the same under the same actions.

A target whose episodes begin as the source's do, and that follows its commands as the source does, is where the source
is after the same actions. G and an estimator that learns through it may be wrong alike about where things are, in a way
that no source image shows; these labels are not. What depends on chance (a random goal, a puck that is hit or missed)
differs from start to start, and is left out.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from datamodules import Episode, Trajectories
from datamodules.unpaired import read_all
from idapt_pl.envs import ImageEnv
from idapt_pl.modules import ActionTransformation, VisualTransformation
from idapt_pl.stages.context import StageContext

log = logging.getLogger(__name__)

EXPLAINED = 0.5
"""Share of the variance of a component, over all that was played, that starts must leave to actions for a label."""


def replayed_labels(
    c: StageContext, step: int, target: Sequence[Path], G: VisualTransformation, F: ActionTransformation | None
) -> list[Path]:
    """``replay_labelled.h5``: the target's images with states that their actions lead to in the source; none if off.

    Args:
        c: of the run.
        step: grounding step.
        target: trajectory files, of which images and actions are used.
        G: F looks through it; None without F.
        F: what the source plays for an action of the target; None is the identity.
    """
    if not (replays := c.labels.replays):
        return []

    def make(seed: int) -> Trajectories:
        data = read_all(target)
        env = c.worlds.training_states(replays) if F is None else c.worlds.grounded(replays, G, F)
        with closing(env):
            rng = np.random.default_rng(seed)
            played = [play_again(env, e.actions, int(rng.integers(2**31))) for e in data]
        states = agreed(played)
        told = 1 - np.isnan(np.concatenate(states)).mean(0)
        log.info("step %d  replays tell %.0f %% of the target's states", step, 100 * told.mean())
        episodes = tuple(told_to(e, s) for e, s in zip(data, states, strict=True))
        return replace(data, episodes=episodes, source=f"{data.source}, with states of the same actions in the source")

    return [c.stages.record(step, "replay_labelled", make)[0]]


def told_to(episode: Episode, states: np.ndarray) -> Episode:
    """Images and actions of a recording, with states (T+1, s)."""
    pixels = episode.observations["pixels"]
    return Episode(episode.actions, {"pixels": pixels, "state": states.astype(np.float32)})


def play_again(env: ImageEnv, actions: np.ndarray, seed: int) -> np.ndarray:
    """States (n, T+1, s) of an environment's n simulations under the same actions (T, nu); NaN after their ends."""
    obs, _ = env.reset(seed=seed)
    states = np.full((env.num_envs, len(actions) + 1, obs["state"].shape[1]), np.nan)
    states[:, 0] = obs["state"]
    ended = np.zeros(env.num_envs, bool)
    for t, action in enumerate(actions):
        obs, _, terminations, truncations, infos = env.step(np.repeat(action[None], env.num_envs, axis=0))
        states[~ended, t + 1] = infos.get("final_obs", obs)["state"][~ended]
        ended |= terminations | truncations
        if ended.all():
            break
    return states


def agreed(played: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Mean states (T+1, s) of what was played, (n, T+1, s) each; NaN where most had ended or starts decide it.

    Args:
        played: one for each recording, of all simulations, NaN after their ends.
    """
    everything = np.concatenate([p.reshape(-1, p.shape[-1]) for p in played])
    varied = np.nanvar(everything, axis=0)
    states = []
    for simulations in played:
        there = ~np.isnan(simulations[:, :, :1])
        count = there.sum(0)
        mean = np.where(there, simulations, 0.0).sum(0) / np.maximum(count, 1)
        spread = np.where(there, simulations - mean, 0.0) ** 2
        by_chance = spread.sum(0) / np.maximum(count - 1, 1)
        told = (by_chance <= (1 - EXPLAINED) * varied) & (2 * count > len(simulations))
        states.append(np.where(told, mean, np.nan))
    return states

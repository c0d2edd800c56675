"""Samples that repeat the one before: the reader was quicker than the sensors, or a message was lost."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.prediction.data import measured_signals

LEAST_JUMP = 5.0
"""A repeat counts where the mechanism moves by so many of the smallest steps that positions show, before and after."""

FEWEST_REPEATS = 3
"""Repeats that are worth a word."""


def stale_rows(model: mujoco.MjModel, where: str, episode: Episode) -> np.ndarray:
    """Rows that show the same as the row before although the mechanism moves, (n,).

    A mechanism at rest, read in coarse steps, repeats itself too: only repeats with motion on both sides count.
    """
    qpos, qvel = measured_signals(model, where, episode)
    seen = np.asarray(qpos, float) if qvel is None else np.concatenate([qpos, qvel], 1).astype(float)
    if len(seen) < 4:
        return np.zeros(0, int)
    same = (np.diff(seen, axis=0) == 0).all(1)
    steps = np.abs(np.diff(np.asarray(qpos, float), axis=0))
    quantum = np.array([c[c > 0].min() if (c > 0).any() else np.inf for c in steps.T])
    usual = np.array([np.median(c[c > 0]) if (c > 0).any() else np.inf for c in steps.T])
    loud = steps > np.maximum(LEAST_JUMP * quantum, 0.3 * usual)
    found = [k + 1 for k in np.flatnonzero(same).tolist() if moves_around(loud, same, k)]
    return np.array(found, int)


def moves_around(loud: np.ndarray, same: np.ndarray, k: int) -> bool:
    """Whether one channel moves both before and after the run of repeats that step k belongs to."""
    before, after = k - 1, k + 1
    while before >= 0 and same[before]:
        before -= 1
    while after < len(same) and same[after]:
        after += 1
    return before >= 0 and after < len(same) and bool((loud[before] & loud[after]).any())


def without_stale_rows(model: mujoco.MjModel, data: Trajectories) -> tuple[Trajectories, int]:
    """The recording with repeated samples interpolated between their neighbours, and how many there were.

    The first sample of a run of equal ones is taken for the measured one. Where there are fewer than
    ``FEWEST_REPEATS``, nothing is changed.
    """
    rows = [stale_rows(model, f"episode_{i}", e) for i, e in enumerate(data)]
    count = sum(map(len, rows))
    if count < FEWEST_REPEATS:
        return data, 0
    episodes = tuple(interpolated(e, r) for e, r in zip(data, rows, strict=True))
    return replace(data, episodes=episodes), count


def interpolated(episode: Episode, rows: np.ndarray) -> Episode:
    """An episode whose positions and velocities in some rows are interpolated from the others."""
    if not len(rows):
        return episode
    kept = np.setdiff1d(np.arange(len(episode) + 1), rows)
    time = episode.timestamps if episode.timestamps is not None else np.arange(len(episode) + 1.0)
    seen = dict(episode.observations)
    for name in ("qpos", "qvel", "state"):
        if name in seen:
            columns = [np.interp(time, time[kept], c[kept]) for c in np.asarray(seen[name], float).T]
            seen[name] = np.stack(columns, 1).astype(np.result_type(seen[name], np.float32))
    return replace(episode, observations=seen)

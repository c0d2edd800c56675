"""Velocities against the positions that they should be the slopes of: no model is needed for this.

Over a few control steps positions change by the sum of the velocities. A ratio of the two other than 1 is a wrong unit,
a wrong sign or a wrong control period; a column that goes along with another joint is out of order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from idapt_pl.deployment_faults.forecast import Signals
from idapt_pl.deployment_faults.joints import ScalarJoints

SPAN = 6
"""Control steps over which changes are compared: noise of the positions weighs less the longer it is."""

MOST_LATE = 8
"""Shifts between velocities and positions that are tried, in control steps to either side."""

CLEAR = 0.9
"""Correlation from which on a velocity and a slope are taken to be the same motion."""


OWN = 0.1
"""By how much less of a velocity a joint's own slope may explain than another's, to be its partner nonetheless."""


@dataclass(frozen=True)
class Agreement:
    """How velocities go along with slopes of positions.

    Attributes:
        correlation: of velocity i with the slope of joint j, at the common shift, (n, n).
        ratio: velocity over slope, of the velocity that goes along with joint j, with its sign, (n,).
        late: by how many control steps that velocity comes after the slope, (n,).
        partner: joint whose slope goes along with each velocity, (n,).
        clear: whether the two go along clearly, (n,), by joint.
    """

    correlation: np.ndarray
    ratio: np.ndarray
    late: np.ndarray
    partner: np.ndarray
    clear: np.ndarray


def compare_velocities(signals: list[Signals], joints: ScalarJoints, moving: list[int]) -> Agreement:
    """Velocities and slopes of the joints that move, by number among ``moving``."""
    q, v = ([columns[j] for j in moving] for columns in (joints.q, joints.v))
    lags = range(-MOST_LATE, MOST_LATE + 1)
    every = {s: changes(signals, q, v, s) for s in lags}
    correlation = np.stack([correlate(*every[s]) for s in lags])
    strength = np.abs(correlation)
    common = int(np.argmax(strength.max(1).sum(1)))
    own = OWN * np.eye(len(moving))  # joints that move together go along with each other's velocities as well
    velocity, joint = linear_sum_assignment(-np.square(strength[common]) - own)
    partner = np.empty(len(moving), int)
    partner[velocity] = joint
    late, ratio, clear = np.zeros(len(moving), int), np.ones(len(moving)), np.zeros(len(moving), bool)
    for i, j in zip(velocity, joint, strict=True):
        best = int(np.argmax(strength[:, i, j]))
        late[j] = lags[best] if strength[best, i, j] ** 2 > strength[MOST_LATE, i, j] ** 2 + 0.02 else 0
        slope, speed = every[late[j]]
        sign = np.sign(correlation[MOST_LATE + late[j], i, j])
        ratio[j] = sign * speed[:, i].std() / max(slope[:, j].std(), 1e-12)
        clear[j] = strength[MOST_LATE + late[j], i, j] > CLEAR
    return Agreement(correlation[common], ratio, late, partner, clear)


def changes(signals: list[Signals], q: list[int], v: list[int], late: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean slopes of positions, and mean velocities ``late`` rows later, over ``SPAN`` steps: (rows, n) each."""
    slope, speed = [], []
    for s in signals:
        rows = np.arange(MOST_LATE, len(s.time) - SPAN - MOST_LATE)
        if not len(rows):
            continue
        time = s.time[rows + SPAN] - s.time[rows]
        slope.append(smoothed((s.qpos[rows + SPAN][:, q] - s.qpos[rows][:, q]) / time[:, None]))
        step = np.diff(s.time)[:, None]
        area = np.concatenate([np.zeros((1, len(v))), np.cumsum((s.qvel[1:, v] + s.qvel[:-1, v]) / 2 * step, 0)])
        at = rows + late
        speed.append(smoothed((area[at + SPAN] - area[at]) / time[:, None]))
    if not slope:
        return np.zeros((0, len(q))), np.zeros((0, len(v)))
    return np.concatenate(slope), np.concatenate(speed)


def smoothed(rows: np.ndarray) -> np.ndarray:
    """Means of ``SPAN`` rows each: what is too fast for the samples would bias the ratio."""
    if len(rows) <= SPAN:
        return rows[:0]
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, 0)])
    return (total[SPAN:] - total[:-SPAN]) / SPAN


def correlate(slope: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Correlation of each velocity with each slope, (n, n); 0 where one of them does not change."""
    if len(slope) < 10:
        return np.zeros((speed.shape[1], slope.shape[1]))
    a, b = (x - x.mean(0) for x in (speed, slope))
    a, b = (x / np.maximum(np.sqrt(np.square(x).sum(0)), 1e-12) for x in (a, b))
    return a.T @ b

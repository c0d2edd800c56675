"""Where recordings show that a joint ran into a stop, so that a diagnosis has to try whether it has one there.

A joint that turns round by itself is slow before it does, and turns now here and now there. One that runs into a stop
arrives fast, be it once, or is turned round at one place again and again. A joint that goes where its model has it
ended shows one, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.effects.candidate import mechanical_joints
from idapt_pl.prediction.data import Recording

ZONE = 0.03
"""Share of a joint's motion that counts as one place."""
SHARPER = 2.0
"""How many times as hard as elsewhere a joint is stopped."""
PLACES, PILE = 4, 6
"""In how many places next to the furthest a joint is seen to turn round, and how many turns in one of them are many."""

RecordedJoint = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times [s], positions and velocities of a joint in one recording, (T+1,) each."""


def stops_shown(model: mujoco.MjModel, data: Sequence[Recording]) -> np.ndarray:
    """Lower and upper stop of each joint, rad or m, (nv, 2); NaN where nothing shows one."""
    found = np.full((model.nv, 2), np.nan)
    for j, v, _ in mechanical_joints(model):
        at = model.jnt_qposadr[j]
        for k, outward in enumerate((-1.0, 1.0)):
            own = outward * float(model.jnt_range[j, k]) if model.jnt_limited[j] else np.inf
            motions = [(r.time, outward * r.qpos[:, at], outward * r.qvel[:, v]) for r in data]
            if (stop := upper_stop(motions, own)) is not None:
                found[v, k] = outward * stop
    return found


def upper_stop(motions: Sequence[RecordedJoint], own: float) -> float | None:
    """Where a joint is stopped on its way up; ``own`` is where the model has it stop, infinite where it does not."""
    top = max(float(q.max()) for _, q, _ in motions)
    zone = ZONE * (top - min(float(q.min()) for _, q, _ in motions))
    if not zone or top > own + zone or is_stopped(motions, top, zone):
        return top if zone else None
    return place_of_turns(motions, top, zone)


def is_stopped(motions: Sequence[RecordedJoint], top: float, zone: float) -> bool:
    """Whether a joint once comes so fast that it must be stopped harder than elsewhere, not to go beyond ``top``."""
    elsewhere = [np.abs(np.diff(s) / np.diff(t))[q[1:] < top - 2 * zone] for t, q, s in motions]
    if not any(map(len, elsewhere)):
        return False
    hard = SHARPER * float(np.quantile(np.concatenate(elsewhere), 0.9))
    for _, q, s in motions:
        arrives = np.flatnonzero((q[:-1] <= top - zone) & (q[1:] > top - zone))
        if np.any(np.maximum(s[arrives], 0) ** 2 / (2 * (top - q[arrives])) > hard):
            return True
    return False


def place_of_turns(motions: Sequence[RecordedJoint], top: float, zone: float) -> float | None:
    """Where as many turns pile up as in all places beside it together; None where they do not."""
    counts = np.zeros(PLACES, int)
    for _, q, _ in motions:
        ends = np.flatnonzero(np.diff(np.concatenate([[0], q > top - PLACES * zone, [0]])))
        for first, last in zip(ends[::2], ends[1::2], strict=True):
            counts[min(int((top - q[first:last].max()) / zone), PLACES - 1)] += first > 0
    most = int(counts.argmax())
    return top - most * zone if counts[most] >= max(PILE, counts.sum() - counts[most]) else None

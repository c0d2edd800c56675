"""Where recordings show that a joint ran into a stop, so that a diagnosis has to try whether it has one there.

At the furthest that a joint comes, something pushes it back harder than anything unexplained pushes it elsewhere. A
joint that goes where its model has it ended shows a stop, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.effects.candidate import mechanical_joints
from idapt_pl.prediction.data import Recording

END = 0.06
"""Share of a joint's motion that counts as the end of it."""
HARDER = 3.0
"""How many times as hard as elsewhere (its 0.9 quantile) a joint is pushed back, be it once.

Where nothing is hidden it is up to 2.3 on arms of servos; stops of two of them, 4 and 20.
"""
MOST_SAMPLES = 20_000
"""That are looked at; of more, every second or third."""


def stops_shown(model: mujoco.MjModel, data: Sequence[Recording]) -> np.ndarray:
    """Lower and upper stop of each joint, rad or m, (nv, 2): the furthest that it came. NaN where nothing shows one."""
    found = np.full((model.nv, 2), np.nan)
    qpos, unexplained = unexplained_accelerations(model, data)
    for j, v, _ in mechanical_joints(model):
        at = model.jnt_qposadr[j]
        for k, outward in enumerate((-1.0, 1.0)):
            q, back = outward * qpos[:, at], -outward * unexplained[:, v]
            top = max(float((outward * r.qpos[:, at]).max()) for r in data)
            end = END * (top - float(q.min()))
            beyond = model.jnt_limited[j] and top > outward * model.jnt_range[j, k] + end / 2
            if end > 0 and (beyond or is_pushed_back(q, back, top - end)):
                found[v, k] = outward * top
    return found


def is_pushed_back(q: np.ndarray, back: np.ndarray, end: float) -> bool:
    """Whether unexplained accelerations back, (n,), at positions (n,) from ``end`` on are harder than elsewhere."""
    near = q > end
    if near.all() or not near.any():
        return False
    return bool(back[near].max() > HARDER * np.quantile(np.abs(back[~near]), 0.9))


def unexplained_accelerations(model: mujoco.MjModel, data: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Of control steps: positions at their end, (n, nq), and mean accelerations that the model has not, (n, nv).

    The model's are those at the begin of a step.
    """
    d, positions, rest = mujoco.MjData(model), [], []
    every = 1 + sum(map(len, data)) // MOST_SAMPLES
    for r in data:
        for k in range(0, len(r), every):
            d.qpos[:], d.qvel[:], d.ctrl[:] = r.qpos[k], r.qvel[k], r.actions[k]
            mujoco.mj_forward(model, d)
            positions.append(r.qpos[k + 1])
            rest.append((r.qvel[k + 1] - r.qvel[k]) / (r.time[k + 1] - r.time[k]) - d.qacc)
    return np.array(positions), np.array(rest)

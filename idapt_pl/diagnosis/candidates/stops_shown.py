"""Where recordings show that a joint ran into a stop, so that a diagnosis has to try whether it has one there.

At the furthest that a joint comes, something pushes it back harder than anything unexplained pushes it elsewhere. A
joint that goes where its model has it ended shows a stop, too.
"""

from __future__ import annotations

import numpy as np

from idapt_pl.effects.candidate import Candidate, mechanical_joints
from idapt_pl.effects.end_stops import ENDS
from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.simulator import Effects, Simulator

END = 0.06
"""Share of a joint's motion that counts as the end of it."""
HARDER = 3.0
"""How many times as hard as elsewhere (its 0.9 quantile) a joint is pushed back, be it once.

Where nothing is hidden it is up to 2.9, but more where links strike each other or the floor; stops, 54 to 213.
"""
MOST_SAMPLES = 20_000
"""That are looked at; of more, every second or third."""


def stops_shown(sim: Simulator, effects: Effects = ()) -> np.ndarray:
    """Lower and upper stop of each joint, rad or m, (nv, 2): the furthest that it came. NaN where nothing shows one.

    Args:
        sim: of the nominal model, with the recordings.
        effects: that it has besides.
    """
    model, furthest = sim.model, furthest_positions(sim)
    found = np.full((model.nv, 2), np.nan)
    qpos, unexplained = unexplained_accelerations(sim, effects)
    for j, v, _ in mechanical_joints(model):
        for k, outward in enumerate((-1.0, 1.0)):
            q, back = outward * qpos[:, model.jnt_qposadr[j]], -outward * unexplained[:, v]
            top = outward * furthest[v, k]
            end = END * (top - float(q.min()))
            beyond = model.jnt_limited[j] and top > outward * model.jnt_range[j, k] + end / 2
            if end > 0 and (beyond or is_pushed_back(q, back, top - end)):
                found[v, k] = furthest[v, k]
    return found


def is_shown(end: Candidate, sim: Simulator, stops: np.ndarray) -> bool:
    """Whether the end of a joint is among stops, (nv, 2), as of :func:`stops_shown`."""
    dof = sim.model.jnt_dofadr[sim.model.joint(end.target).id]
    return bool(np.isfinite(stops[dof, ENDS.index(end.names[0])]))


def furthest_positions(sim: Simulator) -> np.ndarray:
    """How far down and up each joint comes in the recordings, rad or m, (nv, 2); NaN of what is no hinge or slide."""
    positions, found = np.concatenate([r.qpos for r in sim.data]), np.full((sim.model.nv, 2), np.nan)
    for j, v, _ in mechanical_joints(sim.model):
        q = positions[:, sim.model.jnt_qposadr[j]]
        found[v] = q.min(), q.max()
    return found


def is_pushed_back(q: np.ndarray, back: np.ndarray, end: float) -> bool:
    """Whether unexplained accelerations back, (n,), at positions (n,) from ``end`` on are harder than elsewhere."""
    near = q > end
    if near.all() or not near.any():
        return False
    return bool(back[near].max() > HARDER * np.quantile(np.abs(back[~near]), 0.9))


def unexplained_accelerations(sim: Simulator, effects: Effects) -> tuple[np.ndarray, np.ndarray]:
    """Of control steps: positions at their end, (n, nq), and mean accelerations that a model has not, (n, nv).

    The model's are those over the same step, predicted from the state that was measured at its beginning.
    """
    every = 1 + sum(map(len, sim.data)) // MOST_SAMPLES
    starts = [steps_compared(r)[::every] for r in sim.data]
    steps = Windows(np.repeat(np.arange(len(starts)), list(map(len, starts))), np.concatenate(starts), np.array([1]))
    (_, predicted), (qpos, qvel) = sim.predict(effects, steps), sim.measured(steps, steps.offsets)
    return qpos[:, 0], (qvel - predicted)[:, 0] / np.diff(sim.times(steps)[:, :2], axis=1)


def steps_compared(recording: Recording) -> np.ndarray:
    """Numbers of the control steps in which the model is expected to hold."""
    left_out = recording.left_out
    return np.arange(len(recording)) if left_out is None else np.flatnonzero(~left_out)

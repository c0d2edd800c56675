"""Forces that a model lacks to accelerate as was measured, state by state, by MuJoCo's inverse dynamics."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.prediction.rolling import STATE


def lacking_at_states(
    model: mujoco.MjModel, data: mujoco.MjData, states: np.ndarray, controls: np.ndarray, applied: np.ndarray,
    qacc: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Generalised forces that a model would need besides its own to accelerate so, (n, nv), and the accelerations.

    It is asked for millions of states, so MuJoCo's arrays are looked up once.

    Args:
        model: whose contacts and friction are as they would be under these accelerations.
        data: room for it.
        states: as of ``mujoco.mj_getState``, (n, size).
        controls: (n, nu).
        applied: forces on coordinates and on bodies, (n, nv + 6 bodies).
        qacc: (n, nv); None: what the model does by itself.
    """
    n, nv = len(states), model.nv
    needed, driven = np.empty((n, nv)), np.empty((n, nv))
    found = np.empty((n, nv)) if qacc is None else qacc
    on_joints, on_bodies = applied[:, :nv], applied[:, nv:].reshape(n, model.nbody, 6)
    pushed = np.flatnonzero(on_bodies.any((0, 2)))
    command, push, pull, acceleration = data.ctrl, data.qfrc_applied, data.xfrc_applied, data.qacc
    inverse, motors = data.qfrc_inverse, data.qfrc_actuator
    pull[:] = 0.0
    for i in range(n):
        mujoco.mj_setState(model, data, states[i], STATE)
        command[:], push[:], pull[pushed] = controls[i], on_joints[i], on_bodies[i, pushed]
        if qacc is None:
            mujoco.mj_forward(model, data)
            found[i] = acceleration
        else:
            acceleration[:] = qacc[i]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        needed[i], driven[i] = inverse, motors
        for b in pushed:
            wrench = on_bodies[i, b]
            mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xipos[b], b, driven[i])
    return needed - (driven + on_joints), found

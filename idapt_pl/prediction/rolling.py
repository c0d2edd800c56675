"""Many simulations of one model side by side, under forces from outside that are held for some steps."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import rollout

STATE, COMMAND = mujoco.mjtState.mjSTATE_FULLPHYSICS, mujoco.mjtState.mjSTATE_CTRL
COMMAND_AND_FORCE = COMMAND | mujoco.mjtState.mjSTATE_QFRC_APPLIED | mujoco.mjtState.mjSTATE_XFRC_APPLIED

ForcesAt = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""States (n, size) and commands (n, nu) to forces on coordinates and bodies, (n, nv + 6 bodies)."""


def roll(
    model: mujoco.MjModel,
    data: list[mujoco.MjData],
    start: np.ndarray,
    controls: np.ndarray,
    push: np.ndarray | None = None,
    forces_at: ForcesAt | None = None,
    held: int | None = None,
) -> np.ndarray:
    """States after every step, the first one in front: (n, steps + 1, size).

    Args:
        model: that is simulated.
        data: room for it, one for each thread.
        start: first states, (n, size).
        controls: commands in every step, (n, steps, nu).
        push: forces on coordinates in every step, (n, steps, at most nv).
        forces_at: more forces.
        held: steps for which these are held; default to the end.
    """
    n, steps, nu = controls.shape
    states = np.empty((n, steps + 1, start.shape[1]))
    states[:, 0] = start
    models, forced = [model] * n, push is not None or forces_at is not None
    for k in range(0, steps, held or steps):
        ahead = slice(k, min(k + (held or steps), steps))
        inputs = controls[:, ahead]
        if forced:
            inputs = np.zeros((n, ahead.stop - k, nu + model.nv + 6 * model.nbody))
            inputs[..., :nu] = controls[:, ahead]
            if forces_at is not None:
                inputs[..., nu:] = forces_at(states[:, k], controls[:, k])[:, None]
            if push is not None:
                inputs[..., nu : nu + push.shape[2]] += push[:, ahead]
        after = np.empty((n, ahead.stop - k, start.shape[1]))
        rollout.rollout(
            models, data, np.ascontiguousarray(states[:, k]), np.ascontiguousarray(inputs),
            control_spec=int(COMMAND_AND_FORCE if forced else COMMAND), skip_checks=True, nstep=ahead.stop - k,
            state=after, sensordata=np.empty((n, ahead.stop - k, model.nsensordata)), persistent_pool=len(data) > 1,
        )  # fmt: skip
        states[:, k + 1 : ahead.stop + 1] = after
    return states

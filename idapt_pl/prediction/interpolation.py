"""States of a simulation between its time steps."""

from __future__ import annotations

import mujoco
import numpy as np


def interpolate_states(model: mujoco.MjModel, states: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities at times after the first state: cubic Hermite between steps, rotations in between.

    Args:
        model: the model the states belong to.
        states: (n, steps + 1, size).
        at: s, (n, j).

    Returns:
        (n, j, nq) and (n, j, nv).
    """
    h, rows = model.opt.timestep, np.arange(len(states))[:, None]
    qpos, qvel = states[..., 1 : 1 + model.nq], states[..., 1 + model.nq : 1 + model.nq + model.nv]
    k = np.clip(np.floor(at / h + 1e-6).astype(int), 0, states.shape[1] - 1)
    s = np.clip(at / h - k, 0.0, 1.0)[..., None]
    if np.abs(s).max() < 1e-4:
        return qpos[rows, k], qvel[rows, k]
    after = np.minimum(k + 1, states.shape[1] - 1)
    q0, q1, v0, v1 = qpos[rows, k], qpos[rows, after], qvel[rows, k], qvel[rows, after]
    q, (straight, its_speed) = (1 - s) * q0 + s * q1, straight_coordinates(model)
    s2, s3 = s**2, s**3
    ends = (2 * s3 - 3 * s2 + 1) * q0[..., straight] + (3 * s2 - 2 * s3) * q1[..., straight]
    q[..., straight] = ends + h * ((s3 - 2 * s2 + s) * v0[..., its_speed] + (s3 - s2) * v1[..., its_speed])
    for adr in quaternions(model):
        first, second = q0[..., adr : adr + 4], q1[..., adr : adr + 4]
        mean = (1 - s) * first + s * np.where((first * second).sum(-1, keepdims=True) < 0, -second, second)
        q[..., adr : adr + 4] = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
    return q, (1 - s) * v0 + s * v1


def straight_coordinates(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates whose slope is a velocity, and that velocity: hinges, slides, places of free bodies."""
    sizes = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}
    pairs = [
        (q + i, v + i)
        for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True)
        for i in range(sizes.get(int(kind), 1))
    ]
    q, v = np.array(pairs, int).reshape(-1, 2).T
    return q, v


def quaternions(model: mujoco.MjModel) -> list[int]:
    """Where in ``qpos`` rotations of free and ball joints begin."""
    offsets = {int(mujoco.mjtJoint.mjJNT_FREE): 3, int(mujoco.mjtJoint.mjJNT_BALL): 0}
    found = zip(model.jnt_type, model.jnt_qposadr, strict=True)
    return [int(q) + offsets[int(kind)] for kind, q in found if int(kind) in offsets]

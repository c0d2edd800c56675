"""Joints with play: a model that has one more coordinate for each, which nothing measures."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects.base import PLAY_SUFFIX


class BacklashCoordinates:
    """Between measured coordinates and those of a model in which joints have play.

    A link's measured position is that of the motor plus where the link is in its play.

    Args:
        measured: the nominal model.
        simulated: the same with some joints behind others, named by :data:`~idapt_pl.effects.base.PLAY_SUFFIX`.
    """

    def __init__(self, measured: mujoco.MjModel, simulated: mujoco.MjModel) -> None:
        m = simulated
        behind = [j for j in range(m.njnt) if m.joint(j).name.endswith(PLAY_SUFFIX)]
        driven = [m.joint(m.joint(j).name.removesuffix(PLAY_SUFFIX)).id for j in behind]
        self.size, self.nq = len(behind), m.nq
        self.q = np.setdiff1d(np.arange(m.nq), m.jnt_qposadr[behind])
        self.v = np.setdiff1d(np.arange(m.nv), m.jnt_dofadr[behind])
        assert len(self.q) == measured.nq, "every other joint is the nominal model's"
        self.q_play, self.v_play = m.jnt_qposadr[behind], m.jnt_dofadr[behind]
        self.q_driven, self.v_driven = m.jnt_qposadr[driven], m.jnt_dofadr[driven]

    def expand(self, qpos: np.ndarray, qvel: np.ndarray, loose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates of the simulated model: measured ones (n, nq), (n, nv) and places in the play (n, 2, size)."""
        if not self.size:
            return qpos, qvel
        q, v = np.zeros((len(qpos), self.nq)), np.zeros((len(qvel), len(self.v) + self.size))
        q[:, self.q], v[:, self.v] = qpos, qvel
        q[:, self.q_play], v[:, self.v_play] = loose[:, 0], loose[:, 1]
        q[:, self.q_driven] -= loose[:, 0]
        v[:, self.v_driven] -= loose[:, 1]
        return q, v

    def contract(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What would be measured of simulated coordinates (..., nq), (..., nv)."""
        if not self.size:
            return qpos, qvel
        qpos, qvel = qpos.copy(), qvel.copy()
        qpos[..., self.q_driven] += qpos[..., self.q_play]
        qvel[..., self.v_driven] += qvel[..., self.v_play]
        return qpos[..., self.q], qvel[..., self.v]

    def read(self, state: np.ndarray) -> np.ndarray:
        """Places in the play (n, 2, size) of simulated states (n, nq + nv + ...)."""
        return np.stack([state[:, self.q_play], state[:, self.nq + self.v_play]], 1)

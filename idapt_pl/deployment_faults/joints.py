"""The hinges and slides of a model, whose channels deployment faults are looked for in."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np


@dataclass(frozen=True)
class ScalarJoints:
    """Joints with one coordinate each, in the model's order.

    Attributes:
        names: of the joints.
        q, v: columns of their positions and velocities.
        hinge: whether each is a hinge; the others are slides.
        actuators: numbers of the actuators that act on each.
    """

    names: tuple[str, ...]
    q: tuple[int, ...]
    v: tuple[int, ...]
    hinge: tuple[bool, ...]
    actuators: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> ScalarJoints:
        """Those of a model."""
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        found = [j for j in range(model.njnt) if int(model.jnt_type[j]) in kinds]
        on_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
        acting = [np.flatnonzero(on_joints & (model.actuator_trnid[:, 0] == j)).tolist() for j in found]
        return cls(
            tuple(model.joint(j).name or f"joint{j}" for j in found),
            tuple(int(model.jnt_qposadr[j]) for j in found),
            tuple(int(model.jnt_dofadr[j]) for j in found),
            tuple(int(model.jnt_type[j]) == kinds[0] for j in found),
            tuple(map(tuple, acting)),
        )

    def __len__(self) -> int:
        return len(self.names)

    def moving(self, qpos: np.ndarray) -> list[int]:
        """Numbers of those that move at all in measured positions (rows, nq)."""
        spread = qpos[:, list(self.q)].std(0) if len(self) else np.zeros(0)
        return np.flatnonzero(spread > 1e-9).tolist()

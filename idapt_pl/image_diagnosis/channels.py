"""What is compared of a motion that an image sensor reads: positions and velocities of the joints that it can tell."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.prediction.data import position_difference
from idapt_pl.tasks import Task


class ComparedChannels:
    """Positions and velocities of the joints that a state tells of, as channels: positions first, then velocities.

    Args:
        task: whose states they are.
        model: likewise.

    Attributes:
        dofs: degrees of freedom that are compared, (dofs,).
    """

    def __init__(self, task: Task, model: mujoco.MjModel) -> None:
        self.task, self.model = task, model
        self.dofs = np.array([i for i, j in enumerate(model.dof_jntid) if model.joint(j).name not in task.unseen])

    def names_and_units(self) -> list[tuple[str, str]]:
        """Of every channel."""
        joints = [self.model.joint(self.model.dof_jntid[i]) for i in self.dofs]
        turns = [int(j.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE) for j in joints]
        names = [j.name for j in joints] + [f"{j.name} velocity" for j in joints]
        units = ["rad" if t else "m" for t in turns] + ["rad/s" if t else "m/s" for t in turns]
        return list(zip(names, units, strict=True))

    def positions(self, qpos: np.ndarray) -> np.ndarray:
        """From the model's own, (n, dofs)."""
        return position_difference(self.model, self.model.qpos0, qpos)[:, self.dofs]

    def motion(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """All channels, (n, 2 dofs), of ``qpos`` (n, nq) and ``qvel`` (n, nv)."""
        return np.concatenate([self.positions(qpos), qvel[:, self.dofs]], 1)

"""Force laws that MJCF has no words for, in many simulations side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect
from idapt_pl.effects.learned import SignalForce
from idapt_pl.effects.runtime import ForceEffect
from idapt_pl.effects.world import ExternalForce


class AppliedForces:
    """What force laws of the library add; learned ones are :class:`~idapt_pl.prediction.law_history.LawsInWindows`.

    Args:
        model: that is simulated.
        effects: of which force laws count.
        joints_meant: numbers of the joints that a target means.
    """

    def __init__(
        self, model: mujoco.MjModel, effects: Sequence[Effect], joints_meant: Callable[[str], list[int]]
    ) -> None:
        self.model = model
        self.on_bodies: list[tuple[ExternalForce, slice]] = []
        self.on_joints: list[tuple[ForceEffect, np.ndarray, np.ndarray]] = []
        for e in effects:
            if isinstance(e, ExternalForce):
                first = model.nv + 6 * model.body(e.target).id
                self.on_bodies.append((e, slice(first, first + 3)))
            elif isinstance(e, ForceEffect) and not isinstance(e, SignalForce):
                joints = joints_meant(e.target)
                self.on_joints.append((e, model.jnt_qposadr[joints], model.jnt_dofadr[joints]))

    def add_to(self, applied: np.ndarray, states: np.ndarray) -> None:
        """Add them, at these states (n, size), to forces on coordinates and bodies, (n, nv + 6 bodies)."""
        m, time = self.model, states[:, 0]
        qpos, qvel = states[:, 1 : 1 + m.nq], states[:, 1 + m.nq : 1 + m.nq + m.nv]
        for body, place in self.on_bodies:
            applied[:, place] += body.force(qpos, qvel, time)
        for effect, q, v in self.on_joints:
            applied[:, v] += effect.force(qpos[:, q], qvel[:, v], time)

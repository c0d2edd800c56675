"""Effects on joints: friction, rotor inertia, springs, backlash, cogging."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, elements, joints, parameter
from idapt_pl.effects.runtime import ForceEffect


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect that edits one joint at a time."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in joints(spec, self.target):
            self.edit(joint)

    def edit(self, joint: Any) -> None:
        raise NotImplementedError


@dataclass(frozen=True)
class JointDamping(JointEffect):
    """Linear joint damping."""

    name: ClassVar[str] = "joint_damping"
    damping: float = parameter("N·m·s/rad or N·s/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[0] = self.damping  # [1:] are the polynomial terms


@dataclass(frozen=True)
class JointFrictionloss(JointEffect):
    """Dry friction of a joint (MuJoCo's soft constraint)."""

    name: ClassVar[str] = "joint_frictionloss"
    frictionloss: float = parameter("N·m or N", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.frictionloss = self.frictionloss


@dataclass(frozen=True)
class JointArmature(JointEffect):
    """Rotor inertia reflected to the joint."""

    name: ClassVar[str] = "joint_armature"
    armature: float = parameter("kg·m² or kg", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.armature = self.armature


@dataclass(frozen=True)
class JointStiffness(JointEffect):
    """Linear spring of a joint, pulling to its ``springref``."""

    name: ClassVar[str] = "joint_stiffness"
    stiffness: float = parameter("N·m/rad or N/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.stiffness[0] = self.stiffness


@dataclass(frozen=True)
class JointSpringref(JointEffect):
    """Where a joint's spring is at rest."""

    name: ClassVar[str] = "joint_springref"
    springref: float = parameter("rad or m", -1e3, 1e3)

    def edit(self, joint: Any) -> None:
        joint.springref = self.springref


@dataclass(frozen=True)
class JointDrag(JointEffect):
    """Quadratic drag of a joint, against its motion: torque = -drag |v| v (MuJoCo's polynomial damping)."""

    name: ClassVar[str] = "joint_drag"
    drag: float = parameter("N·m·s²/rad² or N·s²/m²", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[1] = self.drag


PLAY_SUFFIX = " play"
"""What the name of a joint behind another one, which is its play, ends in."""


@dataclass(frozen=True)
class JointBacklash(Effect):
    """Play in the gearbox: behind the driven joint the link turns (or slides) freely by ``width`` in all.

    It is a second joint of the same body, limited to plus and minus half the width. The model's coordinate of the
    driven joint is then that of the motor; what the link does is the sum of both.
    """

    name: ClassVar[str] = "joint_backlash"
    width: float = parameter("rad or m", 0.0, 10.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in elements(spec, "joints", self.target):
            if self.width and joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                self.loosen(spec, joint)

    def loosen(self, spec: mujoco.MjSpec, joint: Any) -> None:
        """Put the second joint behind one."""
        # without inertia of its own the motor could not be told from the link
        felt = float(spec.copy().compile().joint(joint.name).M0[0])
        joint.armature = max(joint.armature, 0.01 * felt)
        play = joint.parent.add_joint(name=joint.name + PLAY_SUFFIX, type=joint.type, axis=joint.axis, pos=joint.pos)
        turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        half = self.width / 2 * (180 / np.pi if turns and spec.compiler.degree else 1.0)
        play.limited, play.range = True, (-half, half)
        play.armature = play.frictionloss = play.margin = play.ref = play.springref = 0.0
        play.stiffness[:] = play.damping[:] = 0.0
        play.solref_limit = (2 * spec.option.timestep, 1.0)


@dataclass(frozen=True)
class JointStribeck(ForceEffect):
    """Friction that falls with speed: coulomb + (static - coulomb) exp(-(v/speed)²), against the motion.

    Only a constraint can hold a joint still. So the larger of the two levels is MuJoCo's dry friction, and the force
    law is what it falls by once the joint moves.
    """

    name: ClassVar[str] = "joint_stribeck"
    coulomb: float = parameter("N·m or N", 0.0, 1e6)
    static: float = parameter("N·m or N", 0.0, 1e6)
    speed: float = parameter("rad/s or m/s", 1e-4, 1e3, default=0.1)

    @property
    def constrains(self) -> bool:
        return True

    def constrain(self, spec: mujoco.MjSpec) -> None:
        for joint in elements(spec, "joints", self.target):
            joint.frictionloss += max(self.static, self.coulomb)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        falls_by = max(self.static - self.coulomb, 0.0)
        return falls_by * -np.expm1(-np.square(qvel / self.speed)) * np.sign(qvel)


@dataclass(frozen=True)
class JointCogging(ForceEffect):
    """A torque that repeats with the joint's angle: sine·sin(n q) + cosine·cos(n q)."""

    name: ClassVar[str] = "joint_cogging"
    sine: float = parameter("N·m", -1e4, 1e4)
    cosine: float = parameter("N·m", -1e4, 1e4, default=0.0)
    periods: float = parameter("1/rev", 1.0, 1e3, default=6.0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return self.sine * np.sin(self.periods * qpos) + self.cosine * np.cos(self.periods * qpos)

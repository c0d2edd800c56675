"""Effects on joints: friction, rotor inertia, springs, backlash, cogging."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import PLAY_SUFFIX, Effect, find_elements, find_joints, parameter
from idapt_pl.effects.candidate import (
    Candidate,
    TypicalSizes,
    actuated_dofs,
    joints_with_motor,
    mechanical_joints,
    one_per_joint,
    scalar_joints,
    shared_by_all,
)
from idapt_pl.effects.runtime import ForceEffect


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect that edits one joint at a time."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in find_joints(spec, self.target):
            self.edit(joint)

    @abstractmethod
    def edit(self, joint: Any) -> None:
        """Change one joint (``mujoco.MjsJoint``) in place."""


def per_radian(spec: mujoco.MjSpec, joint: Any) -> float:
    """What a model writes for 1 rad of a hinge (1 m of a slide): 180/π where its angles are in degrees, else 1."""
    return 180 / np.pi if joint.type == mujoco.mjtJoint.mjJNT_HINGE and spec.compiler.degree else 1.0


@dataclass(frozen=True)
class JointDamping(JointEffect):
    """Linear joint damping."""

    name: ClassVar[str] = "joint_damping"
    phrase: ClassVar[str] = "viscous friction (damping) on joint"
    damping: float = parameter("N·m·s/rad or N·s/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[0] = self.damping  # [1:] are the polynomial terms

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return one_per_joint(cls, "damping", model, model.dof_damping, typical.inertia / typical.horizon)


@dataclass(frozen=True)
class JointFrictionloss(JointEffect):
    """Dry friction of a joint (MuJoCo's soft constraint)."""

    name: ClassVar[str] = "joint_frictionloss"
    phrase: ClassVar[str] = "dry friction on joint"
    frictionloss: float = parameter("N·m or N", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.frictionloss = self.frictionloss

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        further = (0.3, 1.0, 3.0, 10.0, 30.0)  # what sticks shows little of a small change
        return one_per_joint(cls, "frictionloss", model, model.dof_frictionloss, typical.torque, further)


@dataclass(frozen=True)
class JointArmature(JointEffect):
    """Rotor inertia reflected to the joint."""

    name: ClassVar[str] = "joint_armature"
    phrase: ClassVar[str] = "rotor inertia (armature) on joint"
    armature: float = parameter("kg·m² or kg", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.armature = self.armature

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        # where first velocities are poorly known, a little more makes things worse before much more mends them
        further = (0.3, 1.0, 3.0)
        joints = joints_with_motor(model)
        return one_per_joint(cls, "armature", model, model.dof_armature, typical.inertia, further, joints)


@dataclass(frozen=True)
class JointStiffness(JointEffect):
    """Linear spring of a joint, pulling to its ``springref``."""

    name: ClassVar[str] = "joint_stiffness"
    phrase: ClassVar[str] = "a spring on joint"
    stiffness: float = parameter("N·m/rad or N/m", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.stiffness[0] = self.stiffness

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        nominal, scale = model.jnt_stiffness, typical.inertia / typical.horizon**2
        singles = [
            Candidate(cls, name, ("stiffness",), (float(nominal[j]),), (scale[v],))
            for j, v, name in mechanical_joints(model)
        ]
        return singles + shared_by_all(model, singles)


@dataclass(frozen=True)
class JointSpringref(Effect):
    """Where a joint's spring is at rest."""

    name: ClassVar[str] = "joint_springref"
    phrase: ClassVar[str] = "rest position of the spring on joint"
    springref: float = parameter("rad or m", -1e3, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in find_joints(spec, self.target):
            joint.springref = self.springref * per_radian(spec, joint)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Where there is a spring."""
        found = []
        for j, v, name in scalar_joints(model):
            if model.jnt_stiffness[j]:
                rest = float(model.qpos_spring[model.jnt_qposadr[j]])
                found.append(Candidate(cls, name, ("springref",), (rest,), (typical.motion[v],)))
        return found


@dataclass(frozen=True)
class JointDrag(JointEffect):
    """Quadratic drag of a joint, against its motion: torque = -drag |v| v (MuJoCo's polynomial damping)."""

    name: ClassVar[str] = "joint_drag"
    phrase: ClassVar[str] = "quadratic drag on joint"
    drag: float = parameter("N·m·s²/rad² or N·s²/m²", 0.0, 1e6)

    def edit(self, joint: Any) -> None:
        joint.damping[1] = self.drag

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        scale = typical.inertia / typical.horizon / typical.speed
        return one_per_joint(cls, "drag", model, model.dof_dampingpoly[:, 0], scale)


@dataclass(frozen=True)
class JointBacklash(Effect):
    """Play in the gearbox: behind the driven joint the link turns (or slides) freely by ``width`` in all.

    It is a second joint of the same body, limited to plus and minus half the width. The model's coordinate of the
    driven joint is then that of the motor; what the link does is the sum of both.
    """

    name: ClassVar[str] = "joint_backlash"
    phrase: ClassVar[str] = "backlash in joint"
    width: float = parameter("rad or m", 0.0, 10.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in find_elements(spec, "joints", self.target):
            if joint.name.endswith(PLAY_SUFFIX):
                continue
            if self.width and joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                self.loosen(spec, joint)

    def loosen(self, spec: mujoco.MjSpec, joint: Any) -> None:
        """Put the second joint behind one; where there is one already, the two plays add up."""
        half = self.width / 2 * per_radian(spec, joint)
        if (there := spec.joint(joint.name + PLAY_SUFFIX)) is not None:
            there.range = (there.range[0] - half, there.range[1] + half)
            return
        # without inertia of its own the motor could not be told from the link
        felt = float(spec.copy().compile().joint(joint.name).M0[0])
        joint.armature = max(joint.armature, 0.01 * felt)
        play = joint.parent.add_joint(name=joint.name + PLAY_SUFFIX, type=joint.type, axis=joint.axis, pos=joint.pos)
        play.limited, play.range = True, (-half, half)
        play.armature = play.frictionloss = play.margin = play.ref = play.springref = 0.0
        play.stiffness[:] = play.damping[:] = 0.0
        play.solref_limit = (2 * spec.option.timestep, 1.0)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Where an actuator drives the joint."""
        driven, found = actuated_dofs(model), []
        for _, v, name in scalar_joints(model):
            if v in driven:
                starts = tuple((f * typical.motion[v],) for f in (0.03, 0.15))
                found.append(Candidate(cls, name, ("width",), (0.0,), (0.1 * typical.motion[v],), starts))
        return found


@dataclass(frozen=True)
class JointStribeck(ForceEffect):
    """Friction that falls with speed: coulomb + (static - coulomb) exp(-(v/speed)²), against the motion.

    Only a constraint can hold a joint still. So the larger of the two levels is MuJoCo's dry friction, and the force
    law is what it falls by once the joint moves.
    """

    name: ClassVar[str] = "joint_stribeck"
    phrase: ClassVar[str] = "friction that falls with speed (Stribeck) on joint"
    coulomb: float = parameter("N·m or N", 0.0, 1e6)
    static: float = parameter("N·m or N", 0.0, 1e6)
    speed: float = parameter("rad/s or m/s", 1e-4, 1e3, default=0.1)

    @property
    def constrains(self) -> bool:
        return True

    def constrain(self, spec: mujoco.MjSpec) -> None:
        for joint in find_elements(spec, "joints", self.target):
            joint.frictionloss += max(self.static, self.coulomb)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        falls_by = max(self.static - self.coulomb, 0.0)
        return falls_by * -np.expm1(-np.square(qvel / self.speed)) * np.sign(qvel)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return [cls.candidate_on(name, v, typical) for _, v, name in mechanical_joints(model)]

    @classmethod
    def candidate_on(cls, joint: str, v: int, typical: TypicalSizes) -> Candidate:
        """The candidate on the joint with degree of freedom ``v``."""
        usual, torque = typical.speed[v], typical.torque[v]
        levels = ((0.1, 0.2), (0.3, 1.0))
        return Candidate(
            cls,
            joint,
            ("coulomb", "static", "speed"),
            (0.0, 0.0, usual / 4),
            (torque, torque, usual / 4),
            starts=tuple((c * torque, s * torque, f * usual) for c, s in levels for f in (0.05, 0.3)),
            span=((0.0, 1e6), (0.0, 1e6), (usual / 50, 10 * usual)),  # slower is plain dry friction
            strength=2,
        )


MOST_PERIODS = 100.0
"""Of a cogging torque in a turn of a joint; more are the teeth of a gear, and too fine for any log."""

COGGING_REPEATS = 1.5
"""How many periods of a cogging torque the recordings must show: less than that is any torque that bends with angle."""


@dataclass(frozen=True)
class JointCogging(ForceEffect):
    """A torque that repeats with the joint's angle: sine·sin(n q) + cosine·cos(n q)."""

    name: ClassVar[str] = "joint_cogging"
    phrase: ClassVar[str] = "cogging in joint"
    sine: float = parameter("N·m", -1e4, 1e4)
    cosine: float = parameter("N·m", -1e4, 1e4, default=0.0)
    periods: float = parameter("1/rev", 1.0, 1e3, default=6.0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return self.sine * np.sin(self.periods * qpos) + self.cosine * np.cos(self.periods * qpos)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """On hinges that turned through enough periods. How many there are in a turn is fitted, too.

        A diagnosis finds out where that fit starts (:mod:`idapt_pl.diagnosis.candidates.periodogram`).
        """
        found = []
        for j, v, name in joints_with_motor(model):
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
                continue
            fewest = max(1.0, 2 * np.pi * COGGING_REPEATS / typical.range[v])
            most = min(MOST_PERIODS, np.pi / (typical.speed[v] * typical.dt))  # more go by between two samples
            if fewest < 0.5 * most:
                usual = float(np.clip(6.0, fewest, most))
                torque, noticeable = typical.torque[v], float(0.3 / typical.range[v])
                span = ((-1e4, 1e4), (-1e4, 1e4), (float(fewest), float(most)))
                names, scale = ("sine", "cosine", "periods"), (torque, torque, noticeable)
                found.append(Candidate(cls, name, names, (0.0, 0.0, usual), scale, span=span, strength=2))
        return found

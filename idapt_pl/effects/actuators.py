"""Effects on actuators: gains, offsets, dead zones, saturation, crossed wires."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, elements, parameter
from idapt_pl.effects.runtime import CommandEffect


@dataclass(frozen=True)
class ActuatorGain(Effect):
    """Scales what a command does: 1 is nominal, 0.8 is a motor that has lost a fifth.

    Of a ``dcmotor`` it divides the resistance, which scales the torque of a voltage and the back-EMF alike.
    """

    name: ClassVar[str] = "actuator_gain"
    gain: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[0] /= max(self.gain, 1e-6)
            else:
                actuator.gainprm[0] *= self.gain


@dataclass(frozen=True)
class MotorConstant(Effect):
    """Torque constant of a ``dcmotor`` relative to nominal; its back-EMF constant goes along."""

    name: ClassVar[str] = "motor_constant"
    factor: float = parameter("1", 1e-3, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[1] *= self.factor
            elif self.target != "*":
                raise ValueError(f"motor_constant: actuator {actuator.name!r} is not a dcmotor")


@dataclass(frozen=True)
class ActuatorKp(Effect):
    """Stiffness of a servo relative to nominal: what it does with command and position alike."""

    name: ClassVar[str] = "actuator_kp"
    factor: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            actuator.gainprm[0] *= self.factor
            actuator.biasprm[0] *= self.factor
            actuator.biasprm[1] *= self.factor


@dataclass(frozen=True)
class ActuatorKv(Effect):
    """Velocity feedback of a servo, or the back-EMF of a motor: force = -kv · velocity."""

    name: ClassVar[str] = "actuator_kv"
    kv: float = parameter("force·s/rad or force·s/m", 0.0, 1e6)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[2] = -self.kv


UNLIMITED = 1e6
"""A limit that is none."""


@dataclass(frozen=True)
class ActuatorBias(CommandEffect):
    """A constant added to every command."""

    name: ClassVar[str] = "actuator_bias"
    bias: float = parameter("command", -1e6, 1e6)

    def law(self, values: np.ndarray) -> np.ndarray:
        return values + self.bias

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] += actuator.gainprm[0] * self.bias


@dataclass(frozen=True)
class ActuatorDeadzone(CommandEffect):
    """Commands smaller than the width do nothing; larger ones lose it. MJCF has no words for it."""

    name: ClassVar[str] = "actuator_deadzone"
    in_mjcf: ClassVar[bool] = False
    width: float = parameter("command", 0.0, 1e6)

    def law(self, values: np.ndarray) -> np.ndarray:
        return np.sign(values) * np.maximum(np.abs(values) - self.width, 0.0)


@dataclass(frozen=True)
class ActuatorRotation(CommandEffect):
    """The plane of two commands is turned by an angle; target: the two actuators' names, or ``"*"`` for the first two.

    For an end effector that is commanded in Cartesian coordinates this is a base that stands askew; a quarter turn of
    two motors is crossed wires. MJCF has no words for it.
    """

    name: ClassVar[str] = "actuator_rotation"
    in_mjcf: ClassVar[bool] = False
    angle: float = parameter("rad", -np.pi, np.pi)

    def columns(self, model: mujoco.MjModel) -> list[int]:
        return [0, 1] if self.target == "*" else [model.actuator(name).id for name in self.target.split()]

    def law(self, values: np.ndarray) -> np.ndarray:
        if values.shape[1] < 2:
            return values
        (u, v), turned = values[:, :2].T, values.copy()
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        turned[:, 0], turned[:, 1] = cosine * u - sine * v, sine * u + cosine * v
        return turned

    def apply(self, spec: mujoco.MjSpec) -> None:
        for name in self.target.split() if self.target != "*" else ():
            elements(spec, "actuators", name)
        if self.target != "*" and len(self.target.split()) != 2:
            raise ValueError(f"actuator_rotation: target must name two actuators, got {self.target!r}")


@dataclass(frozen=True)
class ActuatorSaturation(CommandEffect):
    """Commands are cut off at plus and minus the limit, and the force (before the gear) at plus and minus its own.

    For a motor one is as good as the other. A servo whose set-point is not limited still has a force that is.
    """

    name: ClassVar[str] = "actuator_saturation"
    limit: float = parameter("command", 0.0, UNLIMITED, default=UNLIMITED)
    force: float = parameter("N·m or N", 1e-6, UNLIMITED, default=UNLIMITED)

    def law(self, values: np.ndarray) -> np.ndarray:
        return np.clip(values, -self.limit, self.limit)

    @property
    def constrains(self) -> bool:
        return self.force < UNLIMITED

    def constrain(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            actuator.forcelimited, actuator.forcerange = True, (-self.force, self.force)

    def apply(self, spec: mujoco.MjSpec) -> None:
        if self.constrains:
            self.constrain(spec)
        for actuator in elements(spec, "actuators", self.target) if self.limit < UNLIMITED else ():
            actuator.ctrllimited, actuator.ctrlrange = True, (-self.limit, self.limit)

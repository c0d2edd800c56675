"""Effects on actuators: gains, offsets, dead zones, curves, saturation, crossed wires."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, find_elements, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, named_actuators, scaled_starts, with_shared
from idapt_pl.effects.runtime import CommandEffect


def dc_motors(model: mujoco.MjModel) -> list[int]:
    """Numbers of the ``dcmotor`` actuators."""
    return [i for i in range(model.nu) if model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_DCMOTOR]


def linear_actuators(model: mujoco.MjModel) -> list[int]:
    """Numbers of the actuators whose force is linear in command, position and velocity: no ``dcmotor``, no muscle."""
    gains = np.isin(model.actuator_gaintype, [int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)])
    biases = np.isin(model.actuator_biastype, [int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)])
    return np.flatnonzero(gains & biases).tolist()


def servos(model: mujoco.MjModel) -> list[int]:
    """Numbers of the actuators whose force depends on the position."""
    return [i for i in linear_actuators(model) if model.actuator_biasprm[i, 1]]


@dataclass(frozen=True)
class ActuatorGain(Effect):
    """Scales what a command does: 1 is nominal, 0.8 is a motor that has lost a fifth.

    Of a ``dcmotor`` it divides the resistance, which scales the torque of a voltage and the back-EMF alike; a diagnosis
    calls that :class:`MotorResistance`.
    """

    name: ClassVar[str] = "actuator_gain"
    phrase: ClassVar[str] = "gain of actuator"
    gain: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[0] /= max(self.gain, 1e-6)
            elif actuator.gaintype == mujoco.mjtGain.mjGAIN_MUSCLE:
                actuator.gainprm[PEAK_FORCE] *= self.gain
                actuator.biasprm[PEAK_FORCE] *= self.gain
            else:
                actuator.gainprm[0] *= self.gain

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        linear = linear_actuators(model)
        names = [name for i, name in named_actuators(model) if i in linear]
        return with_shared([Candidate(cls, name, ("gain",), (1.0,), (0.3,), scaled_starts(1.0)) for name in names])


PEAK_FORCE = 2
"""Where in ``gainprm`` and ``biasprm`` a muscle has its force."""

RESISTANCE, TORQUE_CONSTANT, PROPORTIONAL = 0, 1, 4
"""Where in ``gainprm`` a ``dcmotor`` has its resistance, torque constant and the gain of its position loop."""


@dataclass(frozen=True)
class MotorEffect(Effect):
    """Something of a ``dcmotor`` relative to nominal.

    Attributes:
        place: of it in ``gainprm``.
    """

    place: ClassVar[int]
    factor: float = parameter("1", 1e-3, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[self.place] *= self.factor
            elif self.target != "*":
                raise ValueError(f"{self.name}: actuator {actuator.name!r} is not a dcmotor")

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        names = [model.actuator(i).name for i in dc_motors(model)]
        return with_shared([Candidate(cls, name, ("factor",), (1.0,), (0.3,), scaled_starts(1.0)) for name in names])


@dataclass(frozen=True)
class MotorConstant(MotorEffect):
    """Torque constant of a ``dcmotor`` relative to nominal; its back-EMF constant goes along."""

    name: ClassVar[str] = "motor_constant"
    phrase: ClassVar[str] = "torque constant of motor"
    place: ClassVar[int] = TORQUE_CONSTANT


@dataclass(frozen=True)
class MotorResistance(MotorEffect):
    """Resistance of a ``dcmotor``, windings and leads, relative to nominal: more of it weakens torque and back-EMF."""

    name: ClassVar[str] = "motor_resistance"
    phrase: ClassVar[str] = "resistance of motor"
    place: ClassVar[int] = RESISTANCE


@dataclass(frozen=True)
class ActuatorKp(Effect):
    """Stiffness of a servo relative to nominal: what it does with command and position alike.

    Of a ``dcmotor`` with a position loop of its own it is the gain of that loop.
    """

    name: ClassVar[str] = "actuator_kp"
    phrase: ClassVar[str] = "stiffness of servo"
    factor: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                actuator.gainprm[PROPORTIONAL] *= self.factor
                continue
            if self.target == "*" and not actuator.biasprm[1]:
                continue  # of all servos, and this is a motor
            actuator.gainprm[0] *= self.factor
            actuator.biasprm[0] *= self.factor
            actuator.biasprm[1] *= self.factor

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        looped = [i for i in dc_motors(model) if model.actuator_gainprm[i, PROPORTIONAL]]
        names = [model.actuator(i).name for i in sorted([*servos(model), *looped])]
        return with_shared([Candidate(cls, name, ("factor",), (1.0,), (0.3,), scaled_starts(1.0)) for name in names])


@dataclass(frozen=True)
class MotorStrength(Effect):
    """Scales all that an actuator gives, its answers to command, position and velocity: a servo with a weak motor.

    A lower supply or a worn gear does that; its drive still believes in its gains. Of a motor without feedback it is
    :class:`ActuatorGain`, of a servo without feedback of velocities :class:`ActuatorKp`.
    """

    name: ClassVar[str] = "motor_strength"
    phrase: ClassVar[str] = "strength of the motor of actuator"
    factor: float = parameter("1", 0.0, 1e3)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype in (mujoco.mjtGain.mjGAIN_DCMOTOR, mujoco.mjtGain.mjGAIN_MUSCLE):
                continue  # their numbers are other things: see MotorConstant and ActuatorGain
            if self.target != "*" or actuator.biasprm[2]:
                actuator.gainprm[:3] = self.factor * np.asarray(actuator.gainprm[:3])
                actuator.biasprm[:3] = self.factor * np.asarray(actuator.biasprm[:3])

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        names = [model.actuator(i).name for i in linear_actuators(model) if model.actuator_biasprm[i, 2]]
        return with_shared([Candidate(cls, name, ("factor",), (1.0,), (0.3,), scaled_starts(1.0)) for name in names])


@dataclass(frozen=True)
class ActuatorKv(Effect):
    """Velocity feedback of a servo, or the back-EMF of a motor: force = -kv · velocity."""

    name: ClassVar[str] = "actuator_kv"
    phrase: ClassVar[str] = "velocity feedback of actuator"
    kv: float = parameter("force·s/rad or force·s/m", 0.0, 1e6)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR:
                continue  # its biasprm are other things, and its back-EMF follows from its constants
            on_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
            if self.target == "*" and on_joint and not actuator.biasprm[2]:
                continue  # as in candidates: it has no feedback that could be another one
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[2] = -self.kv

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        singles = []
        for i in linear_actuators(model):
            # where a joint is driven, this is its damping by another name; but only feedback can be taken away
            on_joint = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
            if on_joint and model.actuator_biasprm[i, 2] >= 0:
                continue
            kv = max(0.0, -float(model.actuator_biasprm[i, 2]))
            singles.append(Candidate(cls, model.actuator(i).name, ("kv",), (kv,), (kv or 0.1,), scaled_starts(kv)))
        return with_shared(singles)


UNLIMITED, NO_COMMAND = 1e6, 1e-6
"""A limit that is none, and a largest command that is none."""


@dataclass(frozen=True)
class ActuatorBias(CommandEffect):
    """A constant added to every command."""

    name: ClassVar[str] = "actuator_bias"
    phrase: ClassVar[str] = "offset of the commands to actuator"
    bias: float = parameter("command", -1e6, 1e6)

    def law(self, values: np.ndarray) -> np.ndarray:
        return values + self.bias

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.gaintype in (mujoco.mjtGain.mjGAIN_DCMOTOR, mujoco.mjtGain.mjGAIN_MUSCLE):
                continue  # its biasprm are other things: MJCF has no words for it
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] += actuator.gainprm[0] * self.bias

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        half = 0.5 * typical.command
        return with_shared(
            [Candidate(cls, name, ("bias",), (0.0,), (float(half[i]),)) for i, name in named_actuators(model)]
        )


@dataclass(frozen=True)
class ActuatorDeadzone(CommandEffect):
    """Commands smaller than the width do nothing; larger ones lose it. MJCF has no words for it."""

    name: ClassVar[str] = "actuator_deadzone"
    phrase: ClassVar[str] = "dead zone of actuator"
    in_mjcf: ClassVar[bool] = False
    width: float = parameter("command", 0.0, 1e6)

    def law(self, values: np.ndarray) -> np.ndarray:
        return np.sign(values) * np.maximum(np.abs(values) - self.width, 0.0)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        singles = []
        for i, name in named_actuators(model):
            usual = typical.command[i]
            starts = ((0.2 * usual,), (0.6 * usual,))
            singles.append(Candidate(cls, name, ("width",), (0.0,), (float(0.3 * usual),), starts))
        return with_shared(singles)


@dataclass(frozen=True)
class ActuatorCurve(CommandEffect):
    """A share of what a command does goes with its square, as of propellers and valves; MJCF has no words for it.

    u becomes (1 - share) u + share u |u| / full, so that nothing and a full command stay what they are: PX4's model of
    thrust, where the share is ``THR_MDL_FAC``. With a share below 0 small commands do more.
    """

    name: ClassVar[str] = "actuator_curve"
    phrase: ClassVar[str] = "curve of the commands to actuator"
    in_mjcf: ClassVar[bool] = False
    share: float = parameter("1", -1.0, 1.0)
    full: float = parameter("command", NO_COMMAND, UNLIMITED)

    def law(self, values: np.ndarray) -> np.ndarray:
        return (1 - self.share) * values + self.share * values * np.abs(values) / self.full

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Of motors, not of servos, whose commands are positions or velocities."""
        singles, names = [], dict(named_actuators(model))
        for i in linear_actuators(model):
            if i in names and not model.actuator_biasprm[i, 1:3].any():
                limited = model.actuator_ctrllimited[i]
                full = float(np.abs(model.actuator_ctrlrange[i]).max() if limited else 2 * typical.command[i])
                if full >= NO_COMMAND:
                    singles.append(Candidate(cls, names[i], ("share",), (0.0,), (0.3,), fixed=(("full", full),)))
        return singles if len({c.fixed for c in singles}) > 1 else with_shared(singles)


@dataclass(frozen=True)
class ActuatorRotation(CommandEffect):
    """The plane of two commands is turned by an angle; target: the two actuators' names, or ``"*"`` for the first two.

    For an end effector that is commanded in Cartesian coordinates this is a base that stands askew; a quarter turn of
    two motors is crossed wires. MJCF has no words for it.
    """

    name: ClassVar[str] = "actuator_rotation"
    phrase: ClassVar[str] = "rotation of the commands to actuator"
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
            find_elements(spec, "actuators", name)
        if self.target != "*" and len(self.target.split()) != 2:
            raise ValueError(f"actuator_rotation: target must name two actuators, got {self.target!r}")

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Of each actuator and the next one, unless both turn hinges.

        These are turned by crossed wires alone, a quarter of a turn or half of one, which is a deployment fault.
        """
        hinge = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        hinge[hinge] = model.jnt_type[model.actuator_trnid[hinge, 0]] == mujoco.mjtJoint.mjJNT_HINGE
        names = [model.actuator(i).name for i in range(model.nu)]
        pairs = [f"{names[i]} {names[k]}" for i, k in pairwise(range(model.nu)) if not (hinge[i] and hinge[k])]
        return [Candidate(cls, pair, ("angle",), (0.0,), (0.3,), starts=((1.57,),)) for pair in pairs]


def limits_within(limited: int, own: np.ndarray, limit: float) -> tuple[float, float]:
    """Plus and minus a limit, inside a range that there is already, if there is (mjLIMITED_FALSE is 0)."""
    low, high = (-limit, limit) if not limited or own[0] >= own[1] else np.clip(own, -limit, limit)
    return float(low), float(high)


def spread_of(rms: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Standard deviations of magnitudes (n,), where they are not known those of Gaussian signals with these rms."""
    return spread if len(spread) else 0.6 * rms


def levels(rms: float, spread: float, by: tuple[float, ...]) -> tuple[tuple[float], ...]:
    """Magnitudes so many spreads above the mean one: of a signal about 0, or about what a hovering drone needs."""
    return tuple((float(np.sqrt(max(rms**2 - spread**2, 0.0)) + f * spread),) for f in by)


@dataclass(frozen=True)
class ActuatorSaturation(CommandEffect):
    """Commands are cut off at plus and minus the limit, and the force (before the gear) at plus and minus its own.

    For a motor one is as good as the other. A servo whose set-point is not limited still has a force that is.
    """

    name: ClassVar[str] = "actuator_saturation"
    phrase: ClassVar[str] = "saturation of actuator"
    limit: float = parameter("command", 0.0, UNLIMITED, default=UNLIMITED)
    force: float = parameter("N·m or N", 1e-6, UNLIMITED, default=UNLIMITED)

    def law(self, values: np.ndarray) -> np.ndarray:
        return np.clip(values, -self.limit, self.limit)

    @property
    def constrains(self) -> bool:
        return self.force < UNLIMITED

    def constrain(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            actuator.forcerange = limits_within(actuator.forcelimited, actuator.forcerange, self.force)
            actuator.forcelimited = True

    def apply(self, spec: mujoco.MjSpec) -> None:
        if self.constrains:
            self.constrain(spec)
        for actuator in find_elements(spec, "actuators", self.target) if self.limit < UNLIMITED else ():
            actuator.ctrlrange = limits_within(actuator.ctrllimited, actuator.ctrlrange, self.limit)
            actuator.ctrllimited = True

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        limited = model.actuator_ctrllimited.astype(bool)
        widest = np.abs(np.concatenate([[0.0], model.actuator_ctrlrange[limited].ravel()])).max()
        widest = float(widest or 3 * typical.command.max(initial=1.0))
        of_commands = []
        for i, name in named_actuators(model):
            spread = spread_of(typical.command, typical.command_spread)[i]
            starts = levels(typical.command[i], spread, (-0.5, 0.33, 1.0))
            of_commands.append(Candidate(cls, name, ("limit",), (widest,), (float(spread / 1.2),), starts))
        return with_shared(of_commands) + cls.of_forces(model, typical)

    @classmethod
    def of_forces(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Limits of forces, for servos alone: a motor's force is its command, a servo's is not."""
        found, names = [], dict(named_actuators(model))
        for i in servos(model):
            usual, limited = typical.force[i], model.actuator_forcelimited[i]
            widest = float(model.actuator_forcerange[i, 1] if limited else 10 * usual)
            spread = spread_of(typical.force, typical.force_spread)[i]
            starts = levels(usual, spread, (-0.5, 0.33, 1.33))
            if i in names:
                found.append(Candidate(cls, names[i], ("force",), (widest,), (float(spread / 1.2),), starts))
        return found

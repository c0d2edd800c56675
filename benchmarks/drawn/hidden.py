"""What is hidden in a machine: one thing of many kinds, at a place and of a size that are drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np


@dataclass(frozen=True)
class Hidden:
    """What is hidden in a machine: in its compiled model, in what its motors get and in what its sensors say.

    Attributes:
        effect, target: what the library calls it.
        parameter, value: one of its parameters, to compare with an interval; an empty name for none.
        change: of the compiled model.
        command: what becomes of the commands (nu,) that arrive.
        delay: of all commands, s.
        lag: of all commands, the time constant of a filter of first order, s.
        force: besides the model's, (nv,), of positions and velocities.
        offset: of the readings of positions, (nq,); a number for none.
    """

    effect: str
    target: str
    parameter: str = ""
    value: float = 0.0
    change: Callable[[mujoco.MjModel], None] = lambda model: None
    command: Callable[[np.ndarray], np.ndarray] = lambda u: u
    delay: float = 0.0
    lag: float = 0.0
    force: Callable[[np.ndarray, np.ndarray], np.ndarray | float] = lambda q, v: 0.0
    offset: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Place:
    """Where something is hidden: a body, a coordinate and an actuator of a model, drawn; and what is usual there."""

    model: mujoco.MjModel
    period: float
    rng: np.random.Generator
    b: int
    v: int
    a: int

    @property
    def body(self) -> str:
        """Its name."""
        return self.model.body(self.b).name

    @property
    def joint(self) -> str:
        """Its name."""
        return self.model.joint(self.v).name

    @property
    def motor(self) -> str:
        """The actuator's name."""
        return self.model.actuator(self.a).name

    def inertia(self, low: float, high: float) -> float:
        """Some times the joint's inertia."""
        return float(self.model.dof_M0[self.v] * self.rng.uniform(low, high))

    def full(self, low: float, high: float) -> float:
        """Some times the actuator's largest command."""
        return float(self.model.actuator_ctrlrange[self.a, 1] * self.rng.uniform(low, high))

    def either(self, low: tuple[float, float], high: tuple[float, float]) -> float:
        """A factor in one of two ranges."""
        return float(self.rng.choice([self.rng.uniform(*low), self.rng.uniform(*high)]))

    def of_joint(self, effect: str, parameter: str, value: float, array: str) -> Hidden:
        """A value in an array of the compiled model that has one for each coordinate."""
        return Hidden(effect, self.joint, parameter, value, lambda m: getattr(m, array).__setitem__(self.v, value))

    def of_motor(self, effect: str, parameter: str, value: float, law: Callable[[float], float]) -> Hidden:
        """A law of one actuator's command."""
        only = np.arange(self.model.nu) == self.a
        return Hidden(effect, self.motor, parameter, value, command=lambda u: np.where(only, law(u), u))

    def at_joint(self, size: np.ndarray | float) -> np.ndarray:
        """A vector (nv,) with nothing at the other coordinates."""
        return np.where(np.arange(self.model.nv) == self.v, size, 0.0)


def mass(at: Place) -> Hidden:
    """A body of another density."""
    factor, b = at.either((0.5, 0.75), (1.3, 2.0)), at.b

    def change(m: mujoco.MjModel) -> None:
        m.body_mass[b] *= factor
        m.body_inertia[b] *= factor

    return Hidden("body_mass", at.body, "mass", factor * float(at.model.body_mass[b]), change)


def centre(at: Place) -> Hidden:
    """A centre of mass elsewhere along the body."""
    shift = at.model.body_ipos[at.b] * at.either((-0.5, -0.25), (0.25, 0.5))
    return Hidden("body_com", at.body, change=lambda m: m.body_ipos.__setitem__(at.b, m.body_ipos[at.b] + shift))


def damping(at: Place) -> Hidden:
    """Of a joint."""
    more = float(at.model.dof_damping[at.v]) + at.inertia(1.5, 4.0)
    return at.of_joint("joint_damping", "damping", more, "dof_damping")


def friction(at: Place) -> Hidden:
    """Of a joint."""
    more = float(at.model.dof_frictionloss[at.v]) + at.inertia(2.0, 6.0)
    return at.of_joint("joint_frictionloss", "frictionloss", more, "dof_frictionloss")


def rotor(at: Place) -> Hidden:
    """Of a motor, as felt at its joint."""
    at = replace(at, v=int(at.model.actuator_trnid[at.a, 0]))
    more = float(at.model.dof_armature[at.v]) + at.inertia(0.3, 1.0)
    return at.of_joint("joint_armature", "armature", more, "dof_armature")


def spring(at: Place) -> Hidden:
    """At a joint, such as of cables."""
    return at.of_joint("joint_stiffness", "stiffness", at.inertia(10.0, 60.0), "jnt_stiffness")


def drag(at: Place) -> Hidden:
    """Of a joint, with the square of its speed."""
    size = at.inertia(0.5, 2.0)
    return Hidden("joint_drag", at.joint, "drag", size, lambda m: m.dof_dampingpoly.__setitem__((at.v, 0), size))


def ripple(at: Place) -> Hidden | None:
    """Torque of a motor that repeats with the angle of its hinge."""
    at = replace(at, v=int(at.model.actuator_trnid[at.a, 0]))
    if at.model.jnt_type[at.v] != mujoco.mjtJoint.mjJNT_HINGE:
        return None
    size, periods = at.inertia(5.0, 15.0), at.rng.uniform(8.0, 16.0)
    law = Hidden("joint_cogging", at.joint, "periods", periods)
    return replace(law, force=lambda q, v: at.at_joint(size * np.sin(periods * q)))


def gain(at: Place) -> Hidden:
    """A motor that gives less, or more, of all that is asked of it."""
    factor, a = at.either((0.6, 0.85), (1.2, 1.5)), at.a

    def change(m: mujoco.MjModel) -> None:
        if m.actuator_biastype[a]:
            m.actuator_gainprm[a] *= factor
            m.actuator_biasprm[a] *= factor
        else:
            m.actuator_gear[a] *= factor

    servo = at.model.actuator_biastype[a]
    return Hidden(
        *(("motor_strength", at.motor, "factor") if servo else ("actuator_gain", at.motor, "gain")), factor, change
    )


def bias(at: Place) -> Hidden:
    """Of a command."""
    size = at.full(*at.rng.choice([(-0.2, -0.1), (0.1, 0.2)]))
    return at.of_motor("actuator_bias", "bias", size, lambda u: u + size)


def dead_zone(at: Place) -> Hidden:
    """Of a command."""
    width = at.full(0.1, 0.25)
    return at.of_motor("actuator_deadzone", "width", width, lambda u: np.sign(u) * np.maximum(np.abs(u) - width, 0.0))


def limit(at: Place) -> Hidden:
    """Of a command."""
    most = at.full(0.25, 0.5)
    return at.of_motor("actuator_saturation", "limit", most, lambda u: np.clip(u, -most, most))


def delay(at: Place) -> Hidden:
    """Of all commands."""
    late = float(at.rng.uniform(0.5, 2.5) * at.period)
    return Hidden("actuator_delay", "*", "delay", late, delay=late)


def lag(at: Place) -> Hidden:
    """Of all commands."""
    time_constant = float(at.rng.uniform(1.0, 4.0) * at.period)
    return Hidden("actuator_lag", "*", "time_constant", time_constant, lag=time_constant)


def turned(name: str, angle: float, x: float, y: float) -> Hidden:
    """Gravity with a horizontal part, of its strength as it was."""
    gravity = 9.81 * np.array([x, y, -np.cos(angle)])
    return Hidden("gravity_direction", "world", name, angle, lambda m: m.opt.gravity.__setitem__(slice(None), gravity))


def tilt(at: Place) -> Hidden:
    """Of the base."""
    angle = at.either((-0.15, -0.05), (0.05, 0.15))
    return turned("tilt_x", angle, 0.0, np.sin(angle))


def slope(at: Place) -> Hidden:
    """Of a floor, under what moves in the plane."""
    angle = at.either((-0.15, -0.05), (0.05, 0.15))
    return turned("tilt_y", angle, -np.sin(angle), 0.0)


def encoder(at: Place) -> Hidden:
    """A zero that is off."""
    size = at.either((-0.1, -0.03), (0.03, 0.1))
    return Hidden("sensor_bias", at.joint, "bias", size, offset=at.at_joint(size))


def grip(at: Place) -> Hidden:
    """Of all that touches the floor; what is above 2 no floor has."""
    size = min(at.either((0.15, 0.4), (1.4, 1.9)) * float(at.model.geom_friction[:, 0].max()), 1.9)
    return Hidden("contact_friction", "*", "sliding", size, lambda m: m.geom_friction[:, 0].fill(size))


def give(at: Place) -> Hidden:
    """Of all that touches: a softer floor."""
    time_constant = float(at.model.geom_solref[0, 0] * at.rng.uniform(1.8, 4.0))
    return Hidden(
        "contact_softness", "*", "time_constant", time_constant, lambda m: m.geom_solref[:, 0].fill(time_constant)
    )


Kind = Callable[[Place], Hidden | None]
KINDS: tuple[Kind, ...] = (
    *(mass, centre, damping, friction, rotor, spring, drag, ripple),
    *(gain, bias, dead_zone, limit, delay, lag, tilt, encoder),
)
ON_A_FLOOR: tuple[Kind, ...] = (*(k for k in KINDS if k is not tilt), slope, grip, give)
"""What moves in the plane, and touches."""

"""Effects on the way from a command to a force and from a motion to a measurement.

Where MJCF has words for one, ``apply`` writes them. A simulation that replays recorded commands uses
``transform``, ``force`` and ``measure`` instead: delays then need not be whole time steps.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lfilter

from idapt_pl.domains.effects import Effect, elements, parameter

UNLIMITED = 1e6
"""A limit that is none."""


@dataclass(frozen=True)
class Command:
    """Piecewise-constant commands: ``values[k]`` (nu,) holds from ``edges[k]`` to ``edges[k + 1]`` [s]."""

    edges: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Law(Effect):
    """An effect that a simulation can apply itself, outside the model: on commands, forces or measurements."""

    @property
    def constrains(self) -> bool:
        """Whether the simulation needs something in the model beside that."""
        return False

    def constrain(self, spec: mujoco.MjSpec) -> None:
        """Write that into the model."""


@dataclass(frozen=True)
class CommandEffect(Law):
    """Something that happens to a command before it becomes a force; target: an actuator, or ``"*"``.

    Attributes:
        in_mjcf: whether ``apply`` writes it into the model; if not, environments put commands through ``law``.
    """

    in_mjcf: ClassVar[bool] = True

    def columns(self, model: mujoco.MjModel) -> list[int]:
        """The commands that ``law`` takes and gives, as columns of ``data.ctrl``."""
        return [i for i in range(model.nu) if self.target in ("*", model.actuator(i).name)]

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        """What arrives of a command. ``columns`` are the actuators meant, ``step`` the simulation's time step [s]."""
        values = command.values.copy()
        values[:, columns] = self.law(values[:, columns])
        return Command(command.edges, values)

    def law(self, values: np.ndarray) -> np.ndarray:
        """For effects without memory: command to command."""
        raise NotImplementedError

    def apply(self, spec: mujoco.MjSpec) -> None:
        elements(spec, "actuators", self.target)  # no MJCF for it; the target must exist all the same


def per_column(command: Command, columns: list[int], edges: np.ndarray, values: np.ndarray) -> Command:
    """A command some of whose columns have other edges: both sets of edges are kept."""
    union = np.union1d(command.edges, edges)
    union = union[union < max(command.edges[-1], edges[-1])]
    at = np.clip(np.searchsorted(command.edges, union, side="right") - 1, 0, len(command.values) - 1)
    merged = command.values[at]
    at = np.clip(np.searchsorted(edges, union, side="right") - 1, 0, len(values) - 1)
    merged[:, columns] = values[at]
    return Command(np.append(union, union[-1] + 10.0), merged)


def late(command: Command, columns: list[int], by: float) -> Command:
    """A command some of whose columns arrive later by some seconds."""
    return per_column(command, columns, command.edges + by, command.values[:, columns])


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
class ActuatorDelay(CommandEffect):
    """A pure delay of the command. What held before a recording began is taken to be its first command."""

    name: ClassVar[str] = "actuator_delay"
    delay: float = parameter("s", 0.0, 10.0)

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        return late(command, columns, self.delay)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            actuator.delay = self.delay
            actuator.nsample = int(np.ceil(self.delay / spec.option.timestep)) + 1


@dataclass(frozen=True)
class SensorDelay(CommandEffect):
    """All measurements are late by the same time. Target is ``"*"``.

    Once an episode is under way, this and a delay of all commands are one and the same: the measured motion answers
    commands later by the delay. So it is simulated as the latter.
    """

    name: ClassVar[str] = "sensor_delay"
    delay: float = parameter("s", 0.0, 10.0)

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        every = list(range(command.values.shape[1]))
        return ActuatorDelay("*", self.delay).transform(command, every, step)

    def apply(self, spec: mujoco.MjSpec) -> None:
        if self.target != "*":
            raise ValueError(f"sensor_delay: target must be '*' (all measurements), got {self.target!r}")


@dataclass(frozen=True)
class ActuatorLag(CommandEffect):
    """A first-order lag of the command (``dyntype="filterexact"``), perhaps after a dead time.

    A dead time of less than a time step, either sign, is convention: whether a simulation lets a step's force follow
    from the filter's state before, in the middle of or after it.
    """

    name: ClassVar[str] = "actuator_lag"
    time_constant: float = parameter("s", 0.0, 10.0)
    dead_time: float = parameter("s", -1.0, 10.0, default=0.0)

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        if self.dead_time:
            command = late(command, columns, self.dead_time)
        if self.time_constant <= 0:
            return command
        edges = np.arange(command.edges[0], command.edges[-1], step)
        held = np.searchsorted(command.edges, edges + 1e-9, side="right") - 1
        held = command.values[np.clip(held, 0, len(command.values) - 1)][:, columns]
        keep = np.exp(-step / self.time_constant)
        share = self.time_constant / step * (1 - keep)  # of the old value in the mean over a step
        before = lfilter([1 - keep], [1, -keep], held, axis=0, zi=keep * held[:1])[0]
        before = np.concatenate([held[:1], before[:-1]])  # the filter's state when each step begins
        filtered = held + share * (before - held)
        return per_column(command, columns, np.append(edges, command.edges[-1]), filtered)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in elements(spec, "actuators", self.target):
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            actuator.dynprm[0] = self.time_constant
            if self.dead_time >= spec.option.timestep:
                ActuatorDelay(actuator.name, self.dead_time).apply(spec)


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


@dataclass(frozen=True)
class ForceEffect(Law):
    """A force law that MJCF has no words for; target: a joint, a body, or ``"*"``."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        elements(spec, self.kind, self.target)

    kind: ClassVar[str] = "joints"

    @abstractmethod
    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Torques on the joints meant, from their (n, joints) positions and velocities."""


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


@dataclass(frozen=True)
class ExternalForce(ForceEffect):
    """A constant force on a body at its centre of mass, in the world's axes."""

    name: ClassVar[str] = "external_force"
    kind: ClassVar[str] = "bodies"
    x: float = parameter("N", -1e6, 1e6, default=0.0)
    y: float = parameter("N", -1e6, 1e6, default=0.0)
    z: float = parameter("N", -1e6, 1e6, default=0.0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.broadcast_to((self.x, self.y, self.z), (len(time), 3))


@dataclass(frozen=True)
class SensingEffect(Law):
    """Something between a joint's motion and its measurement; target: a joint, or ``"*"``."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        elements(spec, "joints", self.target)

    @abstractmethod
    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is measured of positions and velocities."""

    @abstractmethod
    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities from what was measured."""


@dataclass(frozen=True)
class SensorBias(SensingEffect):
    """A constant added to a joint's measured position."""

    name: ClassVar[str] = "sensor_bias"
    bias: float = parameter("rad or m", -1e3, 1e3)

    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos + self.bias, qvel

    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos - self.bias, qvel


@dataclass(frozen=True)
class SensorGain(SensingEffect):
    """A factor on a joint's measured position and velocity."""

    name: ClassVar[str] = "sensor_gain"
    gain: float = parameter("1", 1e-3, 1e3)

    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos * self.gain, qvel * self.gain

    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos / self.gain, qvel / self.gain

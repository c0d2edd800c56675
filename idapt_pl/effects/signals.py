"""Effects on signals: delays and lags of commands, and what sensors make of a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.signal import lfilter

from idapt_pl.effects.base import find_elements, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, mechanical_joints, named_actuators, with_shared
from idapt_pl.effects.runtime import (
    Command,
    CommandEffect,
    SensingEffect,
    delay_columns,
    mean_between,
    replace_columns,
)

FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
"""Dynamics of actuators that are a first-order lag."""


@dataclass(frozen=True)
class ActuatorDelay(CommandEffect):
    """A pure delay of the command, on top of the model's own.

    What held before a recording began is taken to be its first command.
    """

    name: ClassVar[str] = "actuator_delay"
    phrase: ClassVar[str] = "delay of actuator"
    delay: float = parameter("s", 0.0, 10.0)

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        return delay_columns(command, columns, self.delay)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            actuator.delay += self.delay
            actuator.nsample = int(np.ceil(actuator.delay / spec.option.timestep)) + 1

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        dt, starts = typical.dt, tuple((f * typical.dt,) for f in (0.5, 1.0, 2.0, 4.0))
        singles = [Candidate(cls, name, ("delay",), (0.0,), (dt,), starts) for _, name in named_actuators(model)]
        return with_shared(singles)


@dataclass(frozen=True)
class SensorDelay(CommandEffect):
    """All measurements are late by the same time. Target is ``"*"``.

    Once an episode is under way, this and a delay of all commands are one and the same: the measured motion answers
    commands later by the delay. So it is simulated as the latter, and a diagnosis that finds the latter names both.
    """

    name: ClassVar[str] = "sensor_delay"
    phrase: ClassVar[str] = "delay of the sensors of joint"
    searched: ClassVar[bool] = False
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

    A dead time of half a time step, either sign, is convention: whether a simulation lets a step's force follow from
    the filter's state before it or after it, instead of the mean over it. Two lags in a row are nearly one of their
    sum, which ``apply`` writes. An actuator with other dynamics of its own (``dcmotor``, an integrator, a muscle) stays
    as it is: MJCF has no words for a lag in front of one.
    """

    name: ClassVar[str] = "actuator_lag"
    phrase: ClassVar[str] = "first-order lag of actuator"
    time_constant: float = parameter("s", 0.0, 10.0)
    dead_time: float = parameter("s", -1.0, 10.0, default=0.0)

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        if self.time_constant <= 0:
            return delay_columns(command, columns, self.dead_time) if self.dead_time else command
        convention = float(np.clip(self.dead_time, -step / 2, step / 2))
        if self.dead_time != convention:
            command = delay_columns(command, columns, self.dead_time - convention)
        edges = np.arange(command.edges[0], command.edges[-1] + step, step)
        held = mean_between(Command(command.edges, command.values[:, columns]), edges[None])[0]
        keep = np.exp(-step / self.time_constant)
        share = self.time_constant / step * (1 - keep)  # of the old value in the mean over a step
        after = lfilter([1 - keep], [1, -keep], held, axis=0, zi=keep * held[:1])[0]
        before = np.concatenate([held[:1], after[:-1]])  # the filter's state when each step begins
        mean, ends = held + share * (before - held), before if convention > 0 else after
        filtered = mean + abs(convention) / (step / 2) * (ends - mean)
        return replace_columns(command, columns, edges, filtered)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for actuator in find_elements(spec, "actuators", self.target):
            if actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE:
                actuator.dyntype, actuator.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, self.time_constant
            elif actuator.dyntype in FILTERS:
                actuator.dynprm[0] += self.time_constant
            else:
                continue
            if self.dead_time >= spec.option.timestep:
                ActuatorDelay(actuator.name, self.dead_time).apply(spec)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        h, dt = float(model.opt.timestep), typical.dt
        starts = tuple((f * dt, 0.0) for f in (0.3, 1.0, 3.0))
        span = ((0.0, 10.0), (-h, h))  # beyond a time step it is a delay of its own
        names = ("time_constant", "dead_time")
        singles = [
            Candidate(cls, name, names, (0.0, 0.0), (dt, h), starts, span=span, strength=1)
            for _, name in named_actuators(model)
        ]
        return with_shared(singles)


@dataclass(frozen=True)
class SensorBias(SensingEffect):
    """A constant added to a joint's measured position."""

    name: ClassVar[str] = "sensor_bias"
    phrase: ClassVar[str] = "offset of the position sensor of joint"
    bias: float = parameter("rad or m", -1e3, 1e3)

    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos + self.bias, qvel

    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos - self.bias, qvel

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return [
            Candidate(cls, name, ("bias",), (0.0,), (typical.motion[v],)) for _, v, name in mechanical_joints(model)
        ]


SENSOR_GAIN = ((0.8, 1.25),)
"""Where a diagnosis looks: position sensors are off by per cents; a larger scale imitates inertia and gravity."""


@dataclass(frozen=True)
class SensorGain(SensingEffect):
    """A factor on a joint's measured position and velocity."""

    name: ClassVar[str] = "sensor_gain"
    phrase: ClassVar[str] = "scale of the sensors of joint"
    gain: float = parameter("1", 1e-3, 1e3)

    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos * self.gain, qvel * self.gain

    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos / self.gain, qvel / self.gain

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return [
            Candidate(cls, name, ("gain",), (1.0,), (0.2,), span=SENSOR_GAIN) for _, _, name in mechanical_joints(model)
        ]

"""Windows judged by forces: what a model lacks to move as was measured, in place of how far its forecasts are off."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.actuators import (
    ActuatorCurve,
    ActuatorDeadzone,
    ActuatorGain,
    ActuatorSaturation,
    MotorConstant,
    MotorResistance,
    MotorStrength,
)
from idapt_pl.effects.joints import JointBacklash
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.signals import SensorDelay
from idapt_pl.effects.world import Numerics
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.rolling import STATE
from idapt_pl.prediction.simulator import Effects, Simulator
from idapt_pl.prediction.whitening import WhitenedWindows

OF_NO_INSTANT = (SensingEffect, SensorDelay, JointBacklash, Numerics)
"""Effects that no single instant shows: of sensors, of play in joints, of how equations are integrated."""

SHRINKING = (
    ActuatorCurve,
    ActuatorDeadzone,
    ActuatorGain,
    ActuatorSaturation,
    MotorConstant,
    MotorResistance,
    MotorStrength,
)
"""Effects that would win by making torques small: where there are none, none is unexplained.

Besides, torques of an arm that moves against its friction point the way it moves, and so does what a dead zone takes
from them.
"""

NO_SAY = (*OF_NO_INSTANT, *SHRINKING)
"""Effects that are not looked for where models are judged by forces."""

PER_WINDOW = 20
"""Control steps of a window, at most."""


@dataclass(frozen=True)
class ForceWindows(WhitenedWindows):
    """Control steps, each a window of its own, whose residual is the generalised force that a model lacks in it.

    Attributes:
        stretch: number of the window, as forecasts have them, that each is of, (n,).
    """

    stretch: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> ForceWindows:
        return ForceWindows(self.windows[rows], self.W[rows], self.stretch[rows])

    @property
    def clusters(self) -> np.ndarray:
        """What no effect explains lasts for a while, and is another after that."""
        return self.stretch

    def unwhitened(self, sim: Simulator, effects: Effects) -> np.ndarray:
        """Forces that a model lacks, (n, 1, nv)."""
        return lacking_forces(sim, effects, self.windows)[:, None]


def judged_by_forces(windows: Windows, size: np.ndarray) -> ForceWindows:
    """Control steps of windows judged by forces, each in units of its ``size``, (nv,): what nothing explains of it."""
    instants, W = instants_of(windows), np.diag(1.0 / size)
    stretch = np.repeat(np.arange(len(windows)), len(instants) // len(windows))
    return ForceWindows(instants, np.broadcast_to(W, (len(instants), *W.shape)), stretch)


def judges_forces(split: WhitenedWindows) -> bool:
    """Whether windows are judged by forces."""
    return isinstance(split, ForceWindows)


def instants_of(windows: Windows) -> Windows:
    """Some control steps of windows, spread evenly, each as a window of its own."""
    steps = int(windows.offsets[-1])
    within = np.unique(np.linspace(0, steps - 1, min(steps, PER_WINDOW)).round().astype(int))
    starts = windows.start[:, None] + within
    return Windows(np.repeat(windows.episode, len(within)), starts.ravel(), np.ones(1, int))


@dataclass(frozen=True)
class MeasuredMotion:
    """What was measured in n control steps: the mean of its beginning and its end, but for rotations.

    Attributes:
        time: s, (n,).
        qpos: (n, nq).
        qvel: (n, nv).
        qacc: from the beginning to the end, (n, nv).
    """

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    qacc: np.ndarray


def measured_motion(sim: Simulator, instants: Windows) -> MeasuredMotion:
    """What was measured in control steps."""
    (q0, q1), (v0, v1) = (np.moveaxis(x, 1, 0) for x in sim.measured(instants, np.arange(2)))
    t0, t1 = sim.times(instants).T
    qpos = 0.5 * (q0 + q1) if sim.model.nq == sim.model.nv else q0
    return MeasuredMotion(0.5 * (t0 + t1), qpos, 0.5 * (v0 + v1), (v1 - v0) / (t1 - t0)[:, None])


def lacking_forces(sim: Simulator, effects: Effects, instants: Windows) -> np.ndarray:
    """Generalised forces that a model lacks to move as was measured in control steps, (n, nv), by inverse dynamics."""
    said = tuple(e for e in effects if not isinstance(e, OF_NO_INSTANT))
    model, motion = sim.compile(said), measured_motion(sim, instants)
    if model.na:
        states = sim.mean_states(said, instants)
    else:
        states = np.zeros((len(instants), mujoco.mj_stateSize(model, STATE)))
    states[:, 0] = motion.time
    states[:, 1 : 1 + model.nq] = motion.qpos
    states[:, 1 + model.nq : 1 + model.nq + model.nv] = motion.qvel
    return sim.inverse_dynamics(said, instants, states, motion.qacc)[0]

"""By how much a sensor reads positions wrong throughout: what follows from what it reads tells, by the model's physics.

A sensor that learned from another camera's, or another robot's, images may read a pose with an offset that no single
image shows. But a robot that stood a little lower, or leaned a little more, would move otherwise under the same
actions. So simulations begin where readings say, less an offset, play the recorded actions, and are compared with later
readings, less the same offset: multiple shooting (Bock & Plitt 1984), with the sensor's offset as the only unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.prediction.simulator import silence_mujoco
from idapt_pl.smoothing.ensemble import SimulatedEnsemble
from idapt_pl.smoothing.recordings import ReadRecording
from idapt_pl.tasks import Task

SHOT_SECONDS, SHOT_STEPS_LEAST = 0.13, 3
"""How long a simulation goes on from what was read, and control steps at least. Sooner, offsets hardly tell; later, the
errors of single readings have grown too much."""

MOST_SHOTS = 360
"""Simulations at most, whose beginnings are spread over the recordings."""

MOVED = 0.1
"""Units of the states' spread by which an offset is moved to see what that does."""

SMALL_ERROR, LARGE_ERROR = 0.3, 3.0
"""Errors, in mean errors of their component, up to which they count by their square, and from which they do not."""

WILD = 20.0
"""Simulations whose slopes are as steep somewhere are left out: a contact multiplies there whatever is wrong."""

PRIOR = 0.05
"""How firmly offsets are held to zero, in simulations' information about an offset of one spread."""

ITERATIONS, STEP_LENGTHS = 10, (0.5, 1.0, 2.0, 4.0, 8.0)
"""Steps, and how far each may go: noise in where simulations begin makes steps too short (errors in variables)."""

SURE_BY = 2.0
"""Standard errors by which offsets must make forecasts better in recordings that they were not fitted to."""


@dataclass(frozen=True)
class Shots:
    """Stretches of recordings.

    Attributes:
        readings: of a stretch, (n, T+1, s).
        actions: (n, T, nu).
        recording: which one each is of, (n,).
    """

    readings: np.ndarray
    actions: np.ndarray
    recording: np.ndarray

    def __len__(self) -> int:
        return len(self.readings)


def shots_of(recordings: Sequence[ReadRecording], begin: int, steps: int, stride: int = 1) -> Shots:
    """Stretches of so many control steps, evenly over all recordings, each of them from step ``begin`` on.

    One begins ``stride`` control steps after the other, or later where there are many.
    """
    at = [(k, t) for k, r in enumerate(recordings) for t in range(begin, len(r) - steps + 1, stride)]
    at = [at[i] for i in np.unique(np.linspace(0, len(at) - 1, MOST_SHOTS).astype(int))] if at else []
    return Shots(
        np.array([recordings[k].readings[t : t + steps + 1] for k, t in at]),
        np.array([recordings[k].actions[t : t + steps] for k, t in at]),
        np.array([k for k, _ in at], int),
    )


@dataclass(frozen=True)
class Shooting:
    """How far simulations from what was read, less an offset, are from what was read later.

    Attributes:
        task: of the robot.
        domain: its model.
        shots: stretches of recordings.
        scale: of the components of a state, (s,).
    """

    task: Task
    domain: Domain
    shots: Shots
    scale: np.ndarray

    def __call__(self, offset: np.ndarray) -> np.ndarray:
        """Errors of simulations (n, T, s), for an offset (s,), both in units of the scale."""
        states = self.shots.readings - offset * self.scale
        errors = (states[:, 1:] - self.simulate(states[:, 0])) / self.scale
        return np.clip(np.nan_to_num(errors, nan=1e3), -1e3, 1e3)

    @cached_property
    def ensemble(self) -> SimulatedEnsemble:
        """A simulation for each stretch, of a model that is compiled once."""
        return SimulatedEnsemble(self.task, self.domain, len(self.shots))

    def simulate(self, begin: np.ndarray) -> np.ndarray:
        """States (n, T, s) from where simulations begin (n, s), by the recorded actions."""
        ensemble, model, states = self.ensemble, self.ensemble.model, []
        ensemble.put(ensemble.begin(begin))
        with silence_mujoco():
            for actions in np.swapaxes(self.shots.actions, 0, 1):
                commands = self.domain.command(model, np.clip(actions, *model.actuator_ctrlrange.T))
                for data, command in zip(ensemble.data, commands, strict=True):
                    for _ in range(self.task.action_repeat):
                        self.task.play(model, data, command)
                    mujoco.mj_kinematics(model, data)
                states.append([self.task.state(model, data) for data in ensemble.data])
        return np.swapaxes(np.array(states), 0, 1)


def reading_offsets(
    task: Task, domain: Domain, recordings: Sequence[ReadRecording], scale: np.ndarray, begin: int
) -> tuple[np.ndarray, tuple[float, float]]:
    """What is read too much of every component, (s,), and what that gains in recordings that it was not fitted to.

    Each half of the recordings is judged by what the other was fitted to, and the mean of both counts: zeros where they
    do not surely make forecasts better. The gain is in mean errors, with its standard error.

    Args:
        task: of the robot; tells positions and velocities from states.
        domain: its model.
        recordings: as the sensor reads them.
        scale: the states' spread, (s,).
        begin: control steps of each recording that are not looked at.
    """
    none = np.zeros(len(scale))
    steps = max(SHOT_STEPS_LEAST, round(SHOT_SECONDS / task.period(domain.compile())))
    halves = recordings[::2], recordings[1::2]
    fitted = [Shooting(task, domain, shots_of(half, begin, steps), scale) for half in halves]
    apart = [Shooting(task, domain, shots_of(half, begin, steps, stride=steps), scale) for half in halves]
    if min(len(shooting.shots) for shooting in fitted) < len(none):
        return none, (0.0, 0.0)
    offsets = [fit_offset(shooting) for shooting in fitted]
    before, after, clusters = [], [], []
    for first, (judged, offset) in enumerate(zip(reversed(apart), offsets, strict=True)):
        without, with_it = judged(none), judged(offset)
        size = mean_errors(without)
        before.append(loss(without / size))
        after.append(loss(with_it / size))
        clusters.append(2 * judged.shots.recording + first)
    gain, error = paired_gain(*(np.concatenate(parts) for parts in (before, after, clusters)))
    found = np.mean(offsets, 0) * scale
    return (found if gain > SURE_BY * error else none), (gain, error)


def fit_offset(shooting: Shooting) -> np.ndarray:
    """The offset with which simulations fit best, in units of the scale, (s,)."""
    x = np.zeros(len(shooting.scale))
    errors = shooting(x)
    size = mean_errors(errors)
    for _ in range(ITERATIONS):
        step = robust_step(errors / size, slopes_of_errors(shooting, x, errors) / size[:, None], x)
        tried = [(loss(e / size).mean(), y, e) for f in STEP_LENGTHS for y in [x + f * step] for e in [shooting(y)]]
        least, y, there = min(tried, key=lambda t: t[0])
        if least >= loss(errors / size).mean():
            break
        x, errors = y, there
    return x


def slopes_of_errors(shooting: Shooting, x: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """What errors (n, T, s) change by with every component of the offset, (n, T, s, s)."""
    return np.stack([(shooting(x + move) - errors) / MOVED for move in MOVED * np.eye(len(x))], -1)


def robust_step(z: np.ndarray, J: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Where to move an offset (s,), by errors (n, T, s) and their slopes (n, T, s, s), in mean errors."""
    weights = (np.abs(z) < LARGE_ERROR) / np.maximum(np.abs(z), SMALL_ERROR) * (np.abs(J).max(-1) < WILD)
    J, z, w = J.reshape(-1, len(x)), z.ravel(), weights.ravel() / len(z)
    return -np.linalg.solve((J.T * w) @ J + PRIOR * np.eye(len(x)), (J.T * w) @ z + PRIOR * x)


def loss(z: np.ndarray) -> np.ndarray:
    """Of every simulation, (n,), by errors (n, T, s) in mean errors."""
    return np.minimum(np.abs(z), LARGE_ERROR).mean((1, 2))


def mean_errors(errors: np.ndarray) -> np.ndarray:
    """Of every component, (s,), from errors (n, T, s)."""
    return np.abs(errors).mean((0, 1)) + 1e-3

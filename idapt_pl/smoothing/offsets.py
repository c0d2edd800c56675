"""By how much a sensor reads positions wrong throughout: what follows from what it reads tells, by the model's physics.

A sensor that learned from another camera's, or another robot's, images may read a pose with an offset that no single
image shows. But a robot that stood a little lower, or leaned a little more, would move otherwise under the same
actions. So simulations begin where readings say, less an offset, play the recorded actions, and are compared with later
readings, less the same offset: multiple shooting (Bock & Plitt 1984), with the sensor's offset as the only unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from idapt_pl.diagnosis.simulator import silence_mujoco
from idapt_pl.effects import Domain
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import HUBER, ParameterBox, gauss_newton, jacobian, robust_loss
from idapt_pl.smoothing.ensemble import SimulatedEnsemble
from idapt_pl.smoothing.recordings import ReadRecording
from idapt_pl.tasks import Task

SECONDS, STEPS_LEAST = 0.13, 3
"""How long a simulation goes on from what was read, and control steps at least. Sooner, offsets hardly tell; later, the
errors of single readings have grown too much."""

STRIDE, MOST = 3, 360
"""Control steps from one beginning to the next, and beginnings at most."""

USUAL = 0.5
"""Mean errors of a component beyond which they count linearly."""

WILD = 20.0
"""Windows whose slopes are as steep somewhere are left out: a contact multiplies there whatever is wrong."""

LARGEST = 2.0
"""Offsets at most, in units of the states' spread."""

ITERATIONS = 16
STANDARD_ERRORS = 2.0
"""By which offsets must make forecasts better in recordings that they were not fitted to."""


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

    def __getitem__(self, rows: np.ndarray) -> Shots:
        return Shots(self.readings[rows], self.actions[rows], self.recording[rows])


def shots_of(recordings: Sequence[ReadRecording], begin: int, steps: int) -> Shots:
    """Stretches of so many control steps, evenly over all recordings, each of them from step ``begin`` on."""
    at = [(k, t) for k, r in enumerate(recordings) for t in range(begin, len(r) - steps + 1, STRIDE)]
    at = [at[i] for i in np.unique(np.linspace(0, len(at) - 1, MOST).astype(int))] if at else []
    empty = np.zeros((0, 0, 0))
    return Shots(
        np.array([recordings[k].readings[t : t + steps + 1] for k, t in at]) if at else empty,
        np.array([recordings[k].actions[t : t + steps] for k, t in at]) if at else empty,
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
        shown: components that have an offset.
    """

    task: Task
    domain: Domain
    shots: Shots
    scale: np.ndarray
    shown: Sequence[int]

    def errors(self, offset: np.ndarray) -> np.ndarray:
        """Of simulations, in units of the scale, (n, T s), for offsets of the shown components in these units."""
        off = np.zeros(len(self.scale))
        off[list(self.shown)] = offset
        states = self.shots.readings - off * self.scale
        errors = (states[:, 1:] - self.simulate(states[:, 0])) / self.scale
        return np.clip(np.nan_to_num(errors, nan=1e3), -1e3, 1e3).reshape(len(self.shots), -1)

    def simulate(self, begin: np.ndarray) -> np.ndarray:
        """States (n, T, s) from where simulations begin (n, s), by the recorded actions."""
        ensemble = SimulatedEnsemble(self.task, self.domain, len(self.shots))
        model, low_high, states = ensemble.model, ensemble.model.actuator_ctrlrange.T, []
        ensemble.put(ensemble.begin(begin))
        with silence_mujoco():
            for actions in np.swapaxes(self.shots.actions, 0, 1):
                for data, command in zip(ensemble.data, self.domain.command(model, np.clip(actions, *low_high)), strict=True):
                    for _ in range(self.task.action_repeat):
                        self.task.play(model, data, command)
                    mujoco.mj_kinematics(model, data)
                states.append([self.task.state(model, data) for data in ensemble.data])
        return np.swapaxes(np.array(states), 0, 1)


def reading_offsets(
    task: Task, domain: Domain, recordings: Sequence[ReadRecording], scale: np.ndarray, shown: Sequence[int], begin: int
) -> np.ndarray:
    """What is read too much of every component, (s,); zero where it does not surely make other forecasts better.

    Args:
        task: of the robot; tells positions and velocities from states.
        domain: its model.
        recordings: as the sensor reads them.
        scale: the states' spread, (s,).
        shown: components that positions depend on.
        begin: control steps of each recording that are not looked at.
    """
    none = np.zeros(len(scale))
    steps = max(STEPS_LEAST, round(SECONDS / task.period(domain.compile())))
    shots = shots_of(recordings, begin, steps)
    if len(np.unique(shots.recording)) < 2:
        return none
    odd = shots.recording % 2 == 1
    fitted = [fit_offset(Shooting(task, domain, shots[rows], scale, shown)) for rows in (odd, ~odd)]
    before, after = np.zeros(len(shots)), np.zeros(len(shots))
    for rows, offset in ((~odd, fitted[0]), (odd, fitted[1])):
        judged = Shooting(task, domain, shots[rows], scale, shown)
        errors, better = judged.errors(np.zeros(len(shown))), judged.errors(offset)
        size = usual(errors, len(scale))
        before[rows], after[rows] = robust_loss(errors / size), robust_loss(better / size)
    gain, error = paired_gain(before, after, shots.recording)
    if gain < STANDARD_ERRORS * error:
        return none
    none[list(shown)] = np.mean(fitted, 0)
    return none * scale


def fit_offset(shooting: Shooting) -> np.ndarray:
    """The offset of the shown components that makes simulations fit best, in units of the scale."""
    p = len(shooting.shown)
    box = ParameterBox(np.ones(p), np.full(p, -LARGEST), np.full(p, LARGEST))
    start = shooting.errors(np.zeros(p))
    slopes = np.abs(jacobian(shooting.errors, np.zeros(p), start, box)).reshape(*start.shape, p).max((1, 2))
    tame = replace(shooting, shots=shooting.shots[slopes < WILD])
    size = usual(start[slopes < WILD], len(shooting.scale))
    return gauss_newton(lambda x: tame.errors(x) / size, np.zeros(p), box, ITERATIONS).x


def usual(errors: np.ndarray, components: int) -> np.ndarray:
    """What errors (n, T s) are divided by for Huber's loss to be linear beyond :data:`USUAL` mean errors, (T s,)."""
    mean = np.abs(errors).reshape(-1, components).mean(0) + 1e-3
    return np.tile(USUAL / HUBER * mean, errors.shape[1] // components)

"""Recordings of a robot, read by a sensor and smoothed by a model of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.prediction.data import position_difference
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.smoothing.ensemble import SimulatedEnsemble
from idapt_pl.smoothing.fixed_lag import (
    POSITION_NOISE,
    VELOCITY_NOISE,
    EnsembleFilter,
    ReadingModel,
    Smoothed,
    smooth_episode,
)
from idapt_pl.tasks import Task

FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0)
"""How many times as wrong as on source frames readings of the target may be."""

TRIED_RECORDINGS, TRIED_STEPS = 2, 200
"""Recordings, and control steps of each, on which the factors are compared; of shorter recordings as many more."""


@dataclass(frozen=True)
class ReadRecording:
    """An episode as a sensor reads it: ``readings`` of the state (T+1, s), ``actions`` (T, nu) between them."""

    readings: np.ndarray
    actions: np.ndarray

    def __len__(self) -> int:
        return len(self.actions)

    def first(self, steps: int) -> ReadRecording:
        """Its first control steps."""
        return ReadRecording(self.readings[: steps + 1], self.actions[:steps])

    def without(self, offset: np.ndarray, begin: int) -> ReadRecording:
        """With readings less an offset (s,) after the first ``begin`` control steps."""
        later = np.arange(len(self.readings))[:, None] > begin
        return ReadRecording(self.readings - later * offset, self.actions)


def reading_model(task: Task, domain: Domain, readings: np.ndarray, states: np.ndarray) -> ReadingModel:
    """What to expect of readings, from frames whose states are known.

    Args:
        task: tells positions and velocities from states.
        domain: whose states they are.
        readings: of source frames as G shows them, (n, s).
        states: the true ones, (n, s).
    """
    model, error = domain.compile(), np.sqrt(np.square(readings - states).mean(0))
    motions = [task.motion(s[None].astype(float), task.period(model)) for s in states]
    qpos, qvel = (np.concatenate(part) for part in zip(*motions, strict=True))
    positions = position_difference(model, qpos[0], qpos).std(0)
    return ReadingModel(error, np.concatenate([POSITION_NOISE * positions, VELOCITY_NOISE * qvel.std(0)]))


@dataclass(frozen=True)
class RecordingSmoother:
    """Smooths recordings, each on its own.

    Attributes:
        task: of the robot.
        domain: its model.
        expected: of readings and model.
        members: simulations in an ensemble.
        lag: control steps for which a state goes on being corrected.
        threads: recordings smoothed at a time; results do not depend on it.
        starts: states that recordings begin in, (k, s); None where they begin anywhere. What is known there stays known
            for a while, however wrong readings are.
    """

    task: Task
    domain: Domain
    expected: ReadingModel
    members: int
    lag: int
    threads: int = 1
    starts: np.ndarray | None = None

    def __call__(self, recordings: Sequence[ReadRecording], seed: int) -> list[Smoothed]:
        """Smooth recordings; ``seed`` is of the ensembles."""
        model = self.domain.compile()

        def smooth(k: int) -> Smoothed:
            ensemble = SimulatedEnsemble(self.task, self.domain, self.members, model)
            known = EnsembleFilter(ensemble, self.expected, self.lag, seed + k, self.starts)
            return smooth_episode(known, recordings[k].readings, recordings[k].actions)

        return SideBySide(self.threads).map(smooth, range(len(recordings)))

    def supposing(self, factor: float) -> RecordingSmoother:
        """With readings that are so many times as wrong."""
        return replace(self, expected=self.expected.times(factor))

    def forecast_errors(self, recordings: Sequence[ReadRecording], scale: np.ndarray, seed: int) -> dict[float, float]:
        """Mean error of forecast readings, in units of ``scale`` (s,), for each of :data:`FACTORS` of their error.

        The factor with the least is the best one. A sensor is more wrong on real images than on those that it learned
        from, and no state says by how much. But the better an ensemble weighs readings against the model, the better
        what it knows after one reading tells the next.
        """
        tried, errors = last_of(recordings, TRIED_RECORDINGS, TRIED_STEPS), {}
        for factor in FACTORS:
            made = replace(self.supposing(factor), lag=0)(tried, seed)
            errors[factor] = float(np.concatenate([np.abs(s.surprise[1:]) / scale for s in made]).mean())
        return errors


def last_of(recordings: Sequence[ReadRecording], count: int, steps: int) -> list[ReadRecording]:
    """The first ``steps`` control steps of the last ``count`` recordings, and of more before if these are shorter."""
    tried: list[ReadRecording] = []
    for recording in reversed(recordings):
        if sum(map(len, tried)) >= count * steps:
            break
        tried.insert(0, recording.first(steps))
    return tried

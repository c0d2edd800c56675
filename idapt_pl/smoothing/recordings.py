"""Recordings of a robot, read by a sensor and smoothed by a model of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from queue import SimpleQueue

import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.prediction.data import position_difference
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.smoothing.ensemble import SimulatedEnsemble, with_longer_steps
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

BEARABLE = 1.2
"""Times the least error of states that are known, which a larger factor may cost."""


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
        roughly: with longer physics steps where these do (:func:`~idapt_pl.smoothing.ensemble.with_longer_steps`).
    """

    task: Task
    domain: Domain
    expected: ReadingModel
    members: int
    lag: int
    threads: int = 1
    starts: np.ndarray | None = None
    roughly: bool = False

    def __call__(self, recordings: Sequence[ReadRecording], seed: int) -> list[Smoothed]:
        """Smooth recordings; ``seed`` is of the ensembles."""
        task, model = self.task, self.domain.compile()
        if self.roughly:
            task, model = with_longer_steps(task, model)
        idle: SimpleQueue[SimulatedEnsemble] = SimpleQueue()  # each is as long in the making as 40 steps
        for _ in range(max(1, min(self.threads, len(recordings)))):
            idle.put(SimulatedEnsemble(task, self.domain, self.members, model))

        def smooth(k: int) -> Smoothed:
            ensemble = idle.get()
            try:
                known = EnsembleFilter(ensemble, self.expected, self.lag, seed + k, self.starts)
                return smooth_episode(known, recordings[k].readings, recordings[k].actions)
            finally:
                idle.put(ensemble)

        return SideBySide(self.threads).map(smooth, range(len(recordings)))

    def supposing(self, factor: float) -> RecordingSmoother:
        """With readings that are so many times as wrong."""
        return replace(self, expected=self.expected.times(factor))

    def state_errors(
        self, recordings: Sequence[ReadRecording], states: Sequence[np.ndarray], scale: np.ndarray, seed: int
    ) -> dict[float, float]:
        """How wrong smoothed states are where they are known, for each of :data:`FACTORS` of the readings' error.

        Args:
            recordings: of this smoother's domain.
            states: the true ones (T+1, s) of each.
            scale: units of the errors, (s,).
            seed: of the ensembles.

        Returns:
            Factors to mean absolute errors.
        """
        errors = {}
        for factor in FACTORS:
            made = self.supposing(factor)(recordings, seed)
            wrong = [np.abs(m.states - known) / scale for m, known in zip(made, states, strict=True)]
            errors[factor] = float(np.concatenate(wrong).mean())
        return errors


def most_that_is_bearable(errors: Mapping[float, float]) -> float:
    """The largest factor whose states are hardly worse than the best, of :meth:`RecordingSmoother.state_errors`.

    Readings of the target's own images are worse than those of images whose states are known, and wrong for longer: a
    smoother that is told so leans on what is known of the start, and no longer.
    """
    return max(factor for factor, error in errors.items() if error <= BEARABLE * min(errors.values()))

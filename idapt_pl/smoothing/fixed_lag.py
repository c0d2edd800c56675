"""A fixed-lag ensemble Kalman smoother of one recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.estimation.ensemble_kalman import corrected
from idapt_pl.prediction.simulator import silence_mujoco
from idapt_pl.smoothing.ensemble import SimulatedEnsemble

FARTHEST_OFF = 4.0
"""Expected errors that readings are off by on average, over components, where the ensemble is taken to be lost."""

POSITION_NOISE, VELOCITY_NOISE = 0.003, 0.015
"""What a model is taken to get wrong in a control step, of the spread of each position and velocity."""

SPREAD = 1.01
"""Factor on the ensemble's spread in each step, since few guesses think themselves too certain."""


@dataclass(frozen=True)
class ReadingModel:
    """What is to be expected of readings and of the model.

    Attributes:
        error: standard deviation of a reading from the state, (s,).
        drift: of what the model gets wrong in a control step, (2 nv,).
    """

    error: np.ndarray
    drift: np.ndarray

    def times(self, factor: float) -> ReadingModel:
        """With readings that are so many times as wrong."""
        return replace(self, error=self.error * factor)


@dataclass(frozen=True)
class Smoothed:
    """What a smoother makes of an episode.

    Attributes:
        states: the smoothed ones, (T+1, s).
        surprise: readings less what was to be expected before they came, (T+1, s).
        lost: where the ensemble had lost the state and began anew, bool (T+1,).
    """

    states: np.ndarray
    surprise: np.ndarray
    lost: np.ndarray


class EnsembleFilter:
    """An ensemble that actions move and readings correct, with its last states (Evensen and van Leeuwen 2000).

    Past states are corrected by what covaries with the newest reading.

    Args:
        ensemble: simulations of the model.
        expected: of readings and model.
        lag: control steps for which a state goes on being corrected.
        seed: of the ensemble.
        starts: states that episodes begin in, (k, s); None where they begin anywhere.

    Attributes:
        past: the newest states and those up to ``lag`` before, the oldest first, (n, s) each.
    """

    def __init__(
        self,
        ensemble: SimulatedEnsemble,
        expected: ReadingModel,
        lag: int,
        seed: int,
        starts: np.ndarray | None = None,
    ) -> None:
        self.ensemble, self.expected, self.lag, self.starts = ensemble, expected, lag, starts
        self.past: list[np.ndarray] = []
        self._rng = np.random.default_rng(seed)

    def begin_episode(self, reading: np.ndarray) -> None:
        """Forget everything and begin where episodes do; about a reading (s,) if that is not known."""
        if self.starts is None:
            return self.begin(reading)
        drawn = self._rng.integers(0, len(self.starts), len(self.ensemble))
        self.past, self._guesses, self._is_read = [], self.ensemble.begin(self.starts[drawn]), False

    def begin(self, reading: np.ndarray) -> None:
        """Forget everything and begin about a reading (s,)."""
        noise = self._rng.normal(size=(len(self.ensemble), len(reading)))
        self.past, self._guesses = [], self.ensemble.begin(reading + self.expected.error * noise)
        self._is_read = True

    def play(self, action: np.ndarray) -> None:
        """A control step with an action (nu,) has passed."""
        self.ensemble.put(self._guesses)
        after = self.ensemble.advance(action)
        after = after + self.expected.drift * self._rng.normal(size=after.shape)
        self._guesses = after.mean(0) + SPREAD * (after - after.mean(0))

    def take_in(self, reading: np.ndarray) -> tuple[np.ndarray, bool]:
        """A reading (s,) has come. Returns how far it is from what was expected, (s,), and whether the state was lost.

        Where it was the ensemble begins anew with the reading.
        """
        seen = self.ensemble.states(self._guesses)
        surprise = reading - seen.mean(0)
        lost = not self._is_read and self._is_lost(surprise, seen)
        if lost:
            self.begin(reading)
            seen = self.ensemble.states(self._guesses)
        past = [*self.past, seen][-self.lag - 1 :]
        if self._is_read:  # the guesses were drawn about this reading: it counts once
            self._is_read, self.past = False, past
            return surprise, lost
        better = corrected(np.concatenate([self._guesses, *past], 1), seen, reading, self.expected.error, self._rng)
        self._guesses, flat = np.split(better, [self._guesses.shape[1]], axis=1)
        self.past = list(np.split(flat, len(past), axis=1))
        return surprise, lost

    def _is_lost(self, surprise: np.ndarray, seen: np.ndarray) -> bool:
        """Whether a reading is further from what is expected than can be."""
        usual = np.sqrt(seen.var(0) + np.square(self.expected.error))
        return bool(np.mean(np.minimum(np.abs(surprise) / usual, 3 * FARTHEST_OFF)) > FARTHEST_OFF)


def smooth_episode(known: EnsembleFilter, readings: np.ndarray, actions: np.ndarray) -> Smoothed:
    """A whole episode through a filter: readings of the state (T+1, s), actions between them (T, nu)."""
    states, surprise = np.zeros(readings.shape), np.zeros(readings.shape)
    out = Smoothed(states, surprise, np.zeros(len(readings), bool))
    with silence_mujoco():
        for t, reading in enumerate(readings):
            known.play(actions[t - 1]) if t else known.begin_episode(reading)
            surprise[t], out.lost[t] = known.take_in(reading)
            for back, guesses in enumerate(reversed(known.past)):
                states[t - back] = guesses.mean(0)
    return out

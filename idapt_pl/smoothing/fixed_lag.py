"""A fixed-lag ensemble Kalman smoother of one recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.diagnosis.simulator import silence_mujoco
from idapt_pl.estimation.ensemble_kalman import corrected
from idapt_pl.smoothing.ensemble import SimulatedEnsemble

FARTHEST_OFF = 4.0
"""Expected errors that readings are off by on average, over components, where the ensemble is taken to be lost."""

POSITION_NOISE, VELOCITY_NOISE = 0.01, 0.05
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
        spread: of the ensemble about them, (T+1, s).
        surprise: readings less what was to be expected before they came, (T+1, s).
        lost: where the ensemble had lost the state and began anew, bool (T+1,).
    """

    states: np.ndarray
    spread: np.ndarray
    surprise: np.ndarray
    lost: np.ndarray


class FixedLagSmoother:
    """Moves an ensemble by the actions of a recording, and corrects it, and its last states, by every reading.

    After Evensen and van Leeuwen (2000). Past states are corrected by what covaries with the newest reading.

    Args:
        ensemble: simulations of the model.
        expected: of readings and model.
        lag: control steps for which a state goes on being corrected.
    """

    def __init__(self, ensemble: SimulatedEnsemble, expected: ReadingModel, lag: int) -> None:
        self.ensemble, self.expected, self.lag = ensemble, expected, lag

    def __call__(self, readings: np.ndarray, actions: np.ndarray, seed: int) -> Smoothed:
        """Smooth an episode: readings of the state (T+1, s), actions between them (T, nu)."""
        with silence_mujoco():
            return self._smooth(readings, actions, np.random.default_rng(seed))

    def _smooth(self, readings: np.ndarray, actions: np.ndarray, rng: np.random.Generator) -> Smoothed:
        T = len(readings)
        states, spread, surprise = (np.zeros(readings.shape) for _ in range(3))
        out, past = Smoothed(states, spread, surprise, np.zeros(T, bool)), list[np.ndarray]()
        guesses = self._begin(readings[0], rng)
        for t in range(T):
            if t:
                guesses = self._forecast(guesses, actions[t - 1], rng)
            seen = self.ensemble.states(guesses)
            out.surprise[t] = readings[t] - seen.mean(0)
            if t and self._is_lost(out.surprise[t], seen):
                out.lost[t], past = True, []
                guesses = self._begin(readings[t], rng)
                seen = self.ensemble.states(guesses)
            guesses, past = self._correct(guesses, [*past, seen][-self.lag - 1 :], readings[t], rng)
            for back, states in enumerate(reversed(past)):
                out.states[t - back], out.spread[t - back] = states.mean(0), states.std(0)
        return out

    def _begin(self, reading: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Guesses about one reading."""
        noise = rng.normal(size=(len(self.ensemble), len(reading)))
        return self.ensemble.begin(reading + self.expected.error * noise)

    def _forecast(self, guesses: np.ndarray, action: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Guesses after an action."""
        self.ensemble.put(guesses)
        after = self.ensemble.advance(action)
        after = after + self.expected.drift * rng.normal(size=after.shape)
        return after.mean(0) + SPREAD * (after - after.mean(0))

    def _correct(
        self, guesses: np.ndarray, past: list[np.ndarray], reading: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Guesses, and the states of the last steps, by a reading, of which the last of ``past`` is expected."""
        together = np.concatenate([guesses, *past], 1)
        better = corrected(together, past[-1], reading, self.expected.error, rng)
        guesses, flat = np.split(better, [guesses.shape[1]], axis=1)
        return guesses, list(np.split(flat, len(past), axis=1))

    def _is_lost(self, surprise: np.ndarray, seen: np.ndarray) -> bool:
        """Whether a reading is further from what is expected than can be."""
        usual = np.sqrt(seen.var(0) + np.square(self.expected.error))
        return bool(np.mean(np.minimum(np.abs(surprise) / usual, 3 * FARTHEST_OFF)) > FARTHEST_OFF)

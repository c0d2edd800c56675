"""Errors of estimated states that a policy is trained to bear: in every episode another gain and offset."""

from __future__ import annotations

import numpy as np

from idapt_pl.nets.encoder import PixelStatePredictor


class NoObservationNoise:
    """Observations as they are."""

    def renew(self, episodes: np.ndarray) -> None:
        """Nothing to draw."""

    def __call__(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return seen


class ObservationNoise(NoObservationNoise):
    """Per simulation, a random gain and offset on every estimated position; rates share the gain of theirs.

    G does not place things in its images quite where the target's camera would, and differently from state to state.
    Which way is unknown, so a policy for the target should not depend on it (domain randomisation, on states).

    Args:
        predictor: what estimates the standardised state.
        num_envs: n.
        spread: standard deviation of gains and of offsets, the latter in units of the data's spread.
        seed: of the draws.
    """

    def __init__(self, predictor: PixelStatePredictor, num_envs: int, spread: float, seed: int) -> None:
        self.spread, self._rng = spread, np.random.default_rng(seed)
        self._shown = predictor.shown
        self._of = np.arange(predictor.features)  # the position whose gain each component shares
        for rate, position in predictor.rates.items():
            self._of[rate] = position
        self.gain, self.offset = np.ones((2, num_envs, predictor.features), np.float32)
        self.renew(np.ones(num_envs, bool))

    def renew(self, episodes: np.ndarray) -> None:
        """Draw anew for some simulations, bool (n,)."""
        gain, offset = self._rng.normal(0, self.spread, (2, len(episodes), len(self._of)))
        shown = np.isin(np.arange(len(self._of)), self._shown)
        self.gain[episodes] = 1 + gain[episodes][:, self._of]
        self.offset[episodes] = np.where(shown, offset, 0.0)[episodes]

    def __call__(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What :meth:`AsymmetricSAC.remember` returned, with the noise."""
        return {**seen, "observation": seen["observation"] * self.gain + self.offset}


class SlowNoise(NoObservationNoise):
    """Noise on states as errors of estimates are: slow, an autoregressive process for each component, and constant.

    Args:
        scale: of each component, (s,), in its units.
        num_envs: n.
        spread: standard deviation of what changes, in units of ``scale``.
        offset: that of what stays for a whole episode.
        seed: of the draws.
        memory: correlation of what follows each other.
    """

    def __init__(
        self, scale: np.ndarray, num_envs: int, spread: float, offset: float, seed: int, memory: float = 0.8
    ) -> None:
        self._rng, self.memory = np.random.default_rng(seed), memory
        self._spread, self._offset = spread * scale, offset * scale
        self._now, self._constant = self._rng.normal(size=(2, num_envs, len(scale)))

    def renew(self, episodes: np.ndarray) -> None:
        """Draw anew for some simulations, bool (n,)."""
        new = self._rng.normal(size=(2, int(episodes.sum()), self._now.shape[1]))
        self._now[episodes], self._constant[episodes] = new

    def __call__(self, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """States with noise, as ``observation``."""
        new = self._rng.normal(size=self._now.shape)
        self._now = self.memory * self._now + np.sqrt(1 - self.memory**2) * new
        wrong = self._spread * self._now + self._offset * self._constant
        return {**seen, "observation": (seen["observation"] + wrong).astype(np.float32)}

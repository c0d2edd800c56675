"""Errors of estimated states that a policy is trained to bear: in every episode another gain and offset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idapt_pl.nets.encoder import PixelStatePredictor, backward_difference


class NoObservationNoise:
    """Observations as they are."""

    def renew(self, episodes: np.ndarray) -> None:
        """Nothing to draw."""

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Observations with noise. Where not ``new``, bool (n,), nothing goes on, and what is returned is no good."""
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

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """What :meth:`AsymmetricSAC.remember` returned, with the noise."""
        return {**seen, "observation": seen["observation"] * self.gain + self.offset}


class Flicker(NoObservationNoise):
    """Noise of every image's own on the positions that are read off it, and what it does to rates taken from three.

    Real images are read with errors that change from image to image, and the slope of three readings shows them many
    times as large as the readings themselves. G's images of the source are read more smoothly, so a policy that trains
    on them learns to answer rates as it could not in the target.

    Args:
        predictor: what estimates the standardised state.
        num_envs: n.
        spread: standard deviation of the noise, in units of the data's spread.
        seed: of the draws.
        frames: K, of which the last three at most tell rates.
    """

    def __init__(
        self, predictor: PixelStatePredictor, num_envs: int, spread: float, seed: int, frames: int = 3
    ) -> None:
        self._rng = np.random.default_rng([seed, 2])  # others draw from the seed itself
        size = predictor.std.cpu().numpy()
        self._shown, self._noise = predictor.shown, spread * size[predictor.shown]  # in the state's units
        self._rates = {r: predictor.shown.index(of) for r, of in predictor.rates.items()}
        self._size, self._dt = size, predictor.dt
        self._frames = np.zeros((min(frames, 3), num_envs, len(self._shown)))
        self._begun = np.ones(num_envs, bool)

    def renew(self, episodes: np.ndarray) -> None:
        """Episodes begin, bool (n,): their first image stands for those before it."""
        self._begun |= episodes

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """What :meth:`AsymmetricSAC.remember` returned, with the noise of one image more."""
        newest = self._noise * self._rng.normal(size=self._frames.shape[1:])
        shown = np.concatenate([self._frames[1:], newest[None]])
        shown[:, self._begun] = newest[self._begun]
        going_on = np.ones_like(self._begun) if new is None else new
        self._frames[:, going_on] = shown[:, going_on]
        self._begun &= ~going_on
        wrong = np.zeros_like(seen["observation"])
        wrong[:, self._shown] = self._frames[-1] / self._size[self._shown]
        for rate, position in self._rates.items():
            slope = backward_difference(self._frames[..., position]) / self._dt
            wrong[:, rate] = slope / self._size[rate]
        return {**seen, "observation": seen["observation"] + wrong}


class Several(NoObservationNoise):
    """Several noises, one upon the other."""

    def __init__(self, *noises: NoObservationNoise) -> None:
        self._noises = noises

    def renew(self, episodes: np.ndarray) -> None:
        """Draw anew for some simulations."""
        for noise in self._noises:
            noise.renew(episodes)

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        for noise in self._noises:
            seen = noise(seen, new)
        return seen


class MixedNoise(NoObservationNoise):
    """In each episode one of several noises, drawn evenly.

    Args:
        noises: of the same simulations.
        num_envs: n.
        seed: of the draws.
    """

    def __init__(self, noises: Sequence[NoObservationNoise], num_envs: int, seed: int) -> None:
        self._noises, self._rng = tuple(noises), np.random.default_rng([seed, 3])
        self._which = self._rng.integers(len(self._noises), size=num_envs)

    def renew(self, episodes: np.ndarray) -> None:
        """Draw anew for some simulations, bool (n,)."""
        self._which[episodes] = self._rng.integers(len(self._noises), size=int(episodes.sum()))
        for noise in self._noises:
            noise.renew(episodes)

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """What the noise of each simulation makes of it."""
        noisy = np.stack([noise(seen, new)["observation"] for noise in self._noises])
        return {**seen, "observation": noisy[self._which, np.arange(len(self._which))]}


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

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """States with noise, as ``observation``."""
        later = self.memory * self._now + np.sqrt(1 - self.memory**2) * self._rng.normal(size=self._now.shape)
        self._now = later if new is None else np.where(new[:, None], later, self._now)
        wrong = self._spread * self._now + self._offset * self._constant
        return {**seen, "observation": (seen["observation"] + wrong).astype(np.float32)}


class RecordedErrors(NoObservationNoise):
    """Errors of estimates as they were measured, played again in stretches, each episode's times a factor of its own.

    Errors of estimates are rarely large, but then for several steps and in several components at once: one that loses
    sight of a foot falls. No noise of one size for all components is like that.

    Args:
        errors: estimates less true states of whole episodes, (T, s) each.
        num_envs: n.
        seed: of what is played.
    """

    FACTORS = (0.0, 2.0)
    """Range of the factors. Up to two, as in the target estimates are worse than where their errors were measured."""
    STRETCH = (10, 40)
    """Shortest and longest stretch that is played in one piece, control steps."""

    def __init__(self, errors: Sequence[np.ndarray], num_envs: int, seed: int) -> None:
        longest = self.STRETCH[1]
        padded = [np.concatenate([e, np.zeros((longest, e.shape[1]))]) for e in errors]  # a stretch may begin anywhere
        sizes = np.array([len(e) for e in errors])
        self._errors = np.concatenate(padded)
        self._begins = np.repeat(np.cumsum(sizes + longest) - sizes - longest, sizes) + np.concatenate(
            [np.arange(n) for n in sizes]
        )
        self._rng = np.random.default_rng(seed)
        self._at, self._left = np.zeros((2, num_envs), int)
        self._factor = np.ones(num_envs)
        self.renew(np.ones(num_envs, bool))

    def renew(self, episodes: np.ndarray) -> None:
        """Draw stretches and factors anew for some simulations."""
        self._left[episodes] = 0
        self._factor[episodes] = self._rng.uniform(*self.FACTORS, int(episodes.sum()))

    def __call__(self, seen: dict[str, np.ndarray], new: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """States with errors, as ``observation``."""
        going_on = np.ones(len(self._left), bool) if new is None else new
        over = (self._left == 0) & going_on
        self._at[over] = self._rng.choice(self._begins, int(over.sum()))
        self._left[over] = self._rng.integers(*self.STRETCH, int(over.sum()))
        wrong = self._errors[self._at] * self._factor[:, None]
        self._at += going_on
        self._left -= going_on
        return {**seen, "observation": (seen["observation"] + wrong).astype(np.float32)}

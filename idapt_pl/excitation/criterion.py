"""How far apart a motion drives the explanations, in standard deviations of the measurement noise.

A diagnosis compares predictions of short windows with measurements, whitened by the noise of the sensors and of the
window's first state. So does this criterion: with recordings as one explanation predicts them, the windows of another
one leave residuals z, and D = √(Σ z²) is the number of standard deviations by which a likelihood ratio would favour the
first. It is T-optimality (Atkinson & Fedorov 1975) in the space of whitened windows.

Parameters are not known exactly, and a rival may be fitted again to the new recording. So what a change of its
parameters can explain is projected out of z first: the limit of large parameter uncertainty in the criterion of
Buzzi-Ferraris (1990) and of GPdoemd (arXiv 1810.02561). The final numbers come from rivals that are fitted again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from idapt_pl.diagnosis.answer.explanation import Measurement
from idapt_pl.diagnosis.candidates.fit import effects_of, fit_candidates
from idapt_pl.estimation.least_squares import project_out
from idapt_pl.excitation.forecast import Forecast, MotionForecaster, coarse
from idapt_pl.excitation.rivals import Rival
from idapt_pl.prediction.data import Windows, sample_windows
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import WhitenedWindows, initial_sensitivity, whitener

SAMPLES = 5
"""Samples of a window that are compared, as in a diagnosis."""

STEP = 0.02
"""Change of a parameter for derivatives, in scales."""


@dataclass(frozen=True)
class Score:
    """What motions do to the explanations.

    Attributes:
        separations: of every pair of rivals in the order of ``combinations``, standard deviations, (n, pairs).
        information: Fisher information of the first rival's parameters, in units of their scales, (n, p, p).
        forecasts: of each rival.
    """

    separations: np.ndarray
    information: np.ndarray
    forecasts: Sequence[Forecast]


class SeparationCriterion:
    """Scores commands by how they separate rivals.

    Args:
        forecaster: simulates them.
        rivals: the explanations, the leading one first.
        measurement: how the recordings will be measured.
    """

    def __init__(self, forecaster: MotionForecaster, rivals: Sequence[Rival], measurement: Measurement) -> None:
        self.forecast, self.rivals = forecaster, tuple(rivals)
        self.steps = max(2, round(measurement.window_steps * measurement.control_period / forecaster.dt))
        self.noise = Noise(np.array(measurement.sensor_noise), np.array(measurement.initial_state_noise))
        self.pairs = list(combinations(range(len(rivals)), 2))
        self.W: np.ndarray | None = None

    def windows(self, forecast: Forecast, commands: np.ndarray) -> Windows:
        """All windows of the motions, those of each one after the other."""
        return sample_windows(forecast.recordings(commands), np.arange(len(commands)), self.steps, SAMPLES, 10**9, 0)

    def calibrate(self, commands: np.ndarray) -> None:
        """Take the windows' covariance from some motions; the search then uses its mean everywhere."""
        first = coarse(self.rivals[0])
        seen = self.forecast(first, commands)
        windows, sim = self.windows(seen, commands), self.forecast.sim.replaying(seen.recordings(commands))
        at = initial_sensitivity(sim, first, windows, self.noise.start)
        W = whitener(at, self.noise, sim.compared, windows.offsets)
        compared = np.flatnonzero(W.any((0, 1)))
        covariance = np.linalg.inv(np.einsum("nab,nac->nbc", W[:, :, compared], W[:, :, compared]))
        usual = np.median(covariance, 0)
        scale = np.sqrt(np.diag(usual))
        eigenvalues, V = np.linalg.eigh(usual / np.outer(scale, scale))  # a median need not be positive definite
        self.W = np.zeros(W.shape[1:])
        self.W[:, compared] = (V / np.sqrt(np.maximum(eigenvalues, 1e-6))).T / scale

    def __call__(self, commands: np.ndarray) -> Score:
        """Score commands, (n, T, nu)."""
        forecasts, z, slopes = self.residuals(commands)
        apart = [np.sqrt(np.square(d).sum((1, 2))) for d in self.differences(z, slopes)]
        separations = np.stack(apart, 1) if apart else np.zeros((len(commands), 0))
        J = slopes[0].reshape(len(commands), -1, slopes[0].shape[-1])
        return Score(separations, J.transpose(0, 2, 1) @ J, forecasts)

    def growth(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How separations grow over a motion, (1, T, nu): ends of windows, s, (w,), and separations, (pairs, w)."""
        _, z, slopes = self.residuals(commands)
        parts = [np.square(d[0]).sum(1) for d in self.differences(z, slopes)]
        seen = self.forecast(coarse(self.rivals[0]), commands)
        ends = self.windows(seen, commands).start + self.steps
        return ends * self.forecast.dt, np.sqrt(np.cumsum(np.reshape(parts, (len(parts), len(ends))), 1))

    def residuals(self, commands: np.ndarray) -> tuple[list[Forecast], list[np.ndarray], list[np.ndarray]]:
        """Forecasts of the rivals, and their whitened residuals where the first one is right.

        Returns:
            Forecasts, residuals (n, windows, rows) and their derivatives by the free parameters (n, windows, rows, p).
        """
        assert self.W is not None, "calibrate first"
        whitening, each = self.W, self.forecast.sim.side_by_side.map
        forecasts = each(lambda r: self.forecast(coarse(r), commands), self.rivals)
        recordings = forecasts[0].recordings(commands)
        windows, sim = self.windows(forecasts[0], commands), self.forecast.sim.replaying(recordings)

        def whitened(effects: Effects) -> np.ndarray:
            z = sim.residual(effects, windows).reshape(len(windows), -1) @ whitening.T
            return np.clip(z, -1e3, 1e3).reshape(len(commands), -1, len(whitening))

        z = each(lambda r: whitened(coarse(r)), self.rivals)
        pairs = zip(self.rivals, z, strict=True)
        return forecasts, z, each(lambda pair: derivatives(*pair, whitened), pairs)

    def differences(self, z: Sequence[np.ndarray], slopes: Sequence[np.ndarray]) -> list[np.ndarray]:
        """What tells each pair apart, (n, windows, rows), without what either one's parameters can explain."""
        bases = [np.linalg.qr(J.reshape(len(J), -1, J.shape[-1]))[0] for J in slopes]
        return [least_difference(z[a] - z[b], bases[a], bases[b]) for a, b in self.pairs]

    def after_refit(self, commands: np.ndarray) -> np.ndarray:
        """Separations of all pairs by a motion (T, nu), one rival fitted again to what the other predicts, (pairs,)."""
        each = self.forecast.sim.side_by_side.map
        left = each(lambda a: self.left_by_others(a, commands[None]), range(len(self.rivals)))
        return np.array([min(left[a][b], left[b][a]) for a, b in self.pairs])

    def left_by_others(self, truth: int, commands: np.ndarray) -> list[float]:
        """What each rival leaves when it is fitted to what one predicts of a motion (1, T, nu), exactly whitened."""
        right = self.rivals[truth]
        seen = self.forecast(right.effects, commands)
        sim, windows = self.forecast.sim.replaying(seen.recordings(commands)), self.windows(seen, commands)
        at = initial_sensitivity(sim, right.effects, windows, self.noise.start)
        split = WhitenedWindows(windows, whitener(at, self.noise, sim.compared, windows.offsets))
        zero = split.residual(sim, right.effects)  # with memory before the window it does not predict itself exactly

        def residual(effects: Effects) -> np.ndarray:
            return np.clip(split.residual(sim, effects) - zero, -1e3, 1e3)

        def after_fit(rival: Rival) -> float:
            x = fit_candidates(residual, rival.fixed, rival.candidates, rival.x, 4).x
            return float(np.linalg.norm(residual((*rival.fixed, *effects_of(rival.candidates, x)))))

        return [0.0 if b == truth else after_fit(rival) for b, rival in enumerate(self.rivals)]


def derivatives(rival: Rival, base: np.ndarray, whitened: Callable[[Effects], np.ndarray]) -> np.ndarray:
    """D z / d (x / scale) of a rival's parameters, (n, windows, rows, p), by one-sided differences."""
    known = tuple(e for e in coarse(rival) if e in rival.fixed)
    columns = []
    for i, c in enumerate(rival.candidates):
        _, high = c.bounds()
        for k in range(c.size):
            x = [v.copy() for v in rival.x]
            sign = 1.0 if x[i][k] + STEP * c.scale[k] <= high[k] else -1.0
            x[i][k] += sign * STEP * c.scale[k]
            columns.append((whitened((*known, *effects_of(rival.candidates, x))) - base) / (sign * STEP))
    return np.stack(columns, -1)


def least_difference(difference: np.ndarray, *bases: np.ndarray) -> np.ndarray:
    """Differences (n, windows, rows) without what a basis (n, windows rows, p) explains; the one that leaves least."""
    flat = difference.reshape(len(difference), -1, 1)
    left = np.stack([project_out(Q, flat)[..., 0] for Q in bases])
    least = np.linalg.norm(left, axis=-1).argmin(0)
    return left[least, np.arange(len(least))].reshape(difference.shape)

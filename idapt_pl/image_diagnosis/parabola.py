"""Where forecasts are best: a parabola through the scores of several values of a parameter, and how sure that is."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

FITTED_RANGE = 0.7
"""Of the logarithm of a parameter: values further from the best one tried say nothing of where the lowest point is."""

SYSTEMATIC_LOG_STD = 0.1
"""Standard deviation of the logarithm of an estimate by what G and the sensor get wrong on target images alone.

No control shows it: the root mean square error of four recordings by three sensors, which scatter does not explain
(``benchmarks/discovery.py``; ``results/discovery.csv``, seed 0 of HalfCheetah and of Walker2d's easy looks). It is not
a gain of the sensor: one of 10 % at each joint changes an estimate by 1 to 2 %."""


def parabola_minimum(x: np.ndarray, scores: np.ndarray) -> tuple[float, bool]:
    """Where a parabola is lowest, among the values tried or a stride beyond; whether it is among them.

    Args:
        x: logarithms of a parameter's values, (k,) with k > 2.
        scores: at these, (k,).
    """
    best = x[np.argmin(scores)]
    if len(np.unique(x)) < 3:  # at a bound
        return float(best), False
    near = np.abs(x - best) <= max(FITTED_RANGE, np.sort(np.abs(np.unique(x) - best))[2])
    bend, slope, _ = np.polyfit(x[near] - best, scores[near], 2)
    low, high = x[near].min() - best, x[near].max() - best
    stride = (high - low) / 2
    bottom = -slope / (2 * bend) if bend > 0 else np.copysign(np.inf, -slope)
    return float(best + np.clip(bottom, low - stride, high + stride)), bool(low <= bottom <= high)


def minimum_uncertainty(x: np.ndarray, scores: np.ndarray) -> float:
    """Half of a 95 % interval for where it is lowest, of the logarithm of the parameter.

    Two things are unknown: which episodes were seen (jackknife), and what G gets wrong (:data:`SYSTEMATIC_LOG_STD`).

    Args:
        x: logarithms of a parameter's values, (k,).
        scores: of each episode there, (k, n).
    """
    n = scores.shape[1]
    without = np.array([parabola_minimum(x, np.delete(scores, i, 1).mean(1))[0] for i in range(n)])
    of_episodes = student.ppf(0.975, n - 1) * np.sqrt((n - 1) * without.var())
    return float(np.hypot(of_episodes, norm.ppf(0.975) * SYSTEMATIC_LOG_STD))

"""Statistics over a handful of runs: interquartile means, bootstrap intervals, profiles, probability of improvement.

Definitions are those of Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice".
Scores are a list with an array for each cell (a task with a target), which holds one score a run; cells may have
different numbers of runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

Scores = Sequence[np.ndarray]
"""For each cell the scores of its runs, each of shape (runs,)."""
Statistic = Callable[[np.ndarray], np.ndarray]
"""Scores of shape (..., runs) to a number for each row, (...,)."""
REPETITIONS = 10_000
"""Resamplings of a bootstrap."""


@dataclass(frozen=True)
class Estimate:
    """A statistic and its 95 % interval.

    Attributes:
        value: of the scores as they are.
        low, high: percentile bootstrap, 2.5 and 97.5 %.
    """

    value: float
    low: float
    high: float


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """Mean without the lowest and the highest quarter of the scores, each rounded down to whole scores (section 4.3).

    Args:
        scores: shape (..., runs); runs of all cells together.
    """
    return np.asarray(stats.trim_mean(scores, 0.25, axis=-1))


def optimality_gap(scores: np.ndarray) -> np.ndarray:
    """By how much scores fall short of 1 on average; what is above 1 makes up for nothing (section 4.3)."""
    return 1 - np.minimum(scores, 1).mean(-1)


def resampled(scores: Scores, rng: np.random.Generator, repetitions: int = REPETITIONS) -> np.ndarray:
    """Runs drawn with replacement within each cell (stratified), all cells side by side: (repetitions, runs)."""
    drawn = [s[rng.integers(len(s), size=(repetitions, len(s)))] for s in scores]
    return np.concatenate(drawn, axis=1)


def stratified_bootstrap(scores: Scores, statistic: Statistic, rng: np.random.Generator) -> Estimate:
    """A statistic of the runs of all cells together, and the interval that the choice of seeds leaves (section 4.1).

    Of one run a cell the interval has no width, which says nothing about other seeds.

    Args:
        scores: of one method.
        statistic: such as :func:`interquartile_mean`.
        rng: for the resampling.
    """
    value = float(statistic(np.concatenate(list(scores))))
    low, high = np.quantile(statistic(resampled(scores, rng)), [0.025, 0.975])
    return Estimate(value, float(low), float(high))


def performance_profile(
    scores: Scores, thresholds: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of runs whose score is above a threshold, each cell counting the same (section 4.2: run scores).

    Args:
        scores: of one method.
        thresholds: tau, shape (n,).
        rng: for the resampling.

    Returns:
        The profile and the ends of its pointwise 95 % band, each of shape (n,).
    """

    def share(cells: Sequence[np.ndarray]) -> np.ndarray:
        return np.mean([(c[..., None] > thresholds).mean(-2) for c in cells], axis=0)

    repetitions = REPETITIONS // 10  # times thresholds; the band is drawn, not quoted
    drawn = [s[rng.integers(len(s), size=(repetitions, len(s)))] for s in scores]
    low, high = np.quantile(share(drawn), [0.025, 0.975], axis=0)
    return share(list(scores)), low, high


def improvement(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """P(X > Y) of one cell: share of the pairs of runs in which x has more, ties counting half (Mann-Whitney's U).

    Args:
        x: of shape (..., runs of x).
        y: of shape (..., runs of y).
    """
    more = x[..., :, None] - y[..., None, :]
    return (np.sign(more) + 1).mean((-2, -1)) / 2


def probability_of_improvement(x: Scores, y: Scores, rng: np.random.Generator) -> Estimate:
    """How likely a run of one method is to have more than a run of another, in a cell drawn at random (section 4.3).

    Args:
        x: scores of one method.
        y: of another, in the same cells.
        rng: for the resampling, in which each cell of each method is resampled on its own.
    """
    value = np.mean([improvement(a, b) for a, b in zip(x, y, strict=True)])

    def drawn(s: np.ndarray) -> np.ndarray:
        return s[rng.integers(len(s), size=(REPETITIONS, len(s)))]

    again = np.mean([improvement(drawn(a), drawn(b)) for a, b in zip(x, y, strict=True)], axis=0)
    low, high = np.quantile(again, [0.025, 0.975])
    return Estimate(float(value), float(low), float(high))

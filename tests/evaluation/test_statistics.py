"""The statistics agree with their definitions, and with figures that rliable 1.2.0 gave for one small array."""

import numpy as np
import pytest
from scipy import stats

from idapt_pl.evaluation.statistics import (
    improvement,
    interquartile_mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
    stratified_bootstrap,
)

A = np.array([[0.1, 0.9, 0.5], [0.4, 0.7, 0.6], [0.2, 1.3, 0.3], [0.9, 0.8, 0.55], [0.35, 1.1, 0.45]])
B = np.array([[0.3, 0.9, 0.2], [0.1, 0.6, 0.1], [0.25, 1.0, 0.4], [0.5, 0.8, 0.35], [0.15, 0.7, 0.65]])
"""Five runs in three cells; rliable's layout."""
THRESHOLDS = np.array([0, 0.2, 0.25, 0.5, 0.75, 1.0])
SAMPLING = 0.012
"""What two bootstraps with other random numbers may differ by here; steps of a run in a mean of 7 are 0.014 or more."""


def cells(scores):
    return list(scores.T)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.mark.parametrize(
    ("scores", "statistic", "value", "low", "high"),
    [
        (A, interquartile_mean, 0.5833333333333334, 0.47777778, 0.71111111),
        (B, interquartile_mean, 0.4388888888888889, 0.33888889, 0.54444444),
        (A, np.mean, 0.61, 0.51, 0.72),
        (B, np.mean, 0.46666666666666673, 0.39, 0.54666667),
        (A, optimality_gap, 0.41666666666666663, 0.31666667, 0.50333333),
        (B, optimality_gap, 0.5333333333333333, 0.45333333, 0.61),
    ],
)
def test_aggregates_and_intervals_are_those_of_rliable(scores, statistic, value, low, high, rng):
    if statistic is np.mean:
        found = stratified_bootstrap(cells(scores), lambda x: x.mean(-1), rng)
    else:
        found = stratified_bootstrap(cells(scores), statistic, rng)
    assert found.value == pytest.approx(value, abs=1e-12)
    assert found.low == pytest.approx(low, abs=SAMPLING) and found.high == pytest.approx(high, abs=SAMPLING)


def test_the_probability_of_improvement_is_that_of_rliable(rng):
    found = probability_of_improvement(cells(A), cells(B), rng)
    assert found.value == pytest.approx(0.68, abs=1e-12)
    assert found.low == pytest.approx(0.4667, abs=0.02) and found.high == pytest.approx(0.8733, abs=0.02)


def test_profiles_are_those_of_rliable(rng):
    share, low, high = performance_profile(cells(A), THRESHOLDS, rng)
    assert share == pytest.approx([1, 13 / 15, 13 / 15, 8 / 15, 1 / 3, 2 / 15])
    assert performance_profile(cells(B), THRESHOLDS, rng)[0] == pytest.approx([1, 11 / 15, 2 / 3, 0.4, 0.2, 0])
    one_run = 1 / 15 + 1e-9  # ends of the band are whole runs of 15
    assert low == pytest.approx([1, 11 / 15, 11 / 15, 1 / 3, 0.2, 0], abs=one_run)
    assert high == pytest.approx([1, 1, 1, 11 / 15, 7 / 15, 4 / 15], abs=one_run)


def test_the_interquartile_mean_is_that_of_the_definition():
    assert interquartile_mean(np.array([100.0, 1, 2, 3, 4, 5, 6, -50])) == np.mean([2, 3, 4, 5])  # a quarter each
    assert interquartile_mean(np.array([7.0])) == 7 and interquartile_mean(np.array([1.0, 2, 300])) == 101


def test_improvement_is_mann_whitneys_u(rng):
    x, y = rng.integers(0, 6, 9).astype(float), rng.integers(0, 6, 7).astype(float)  # with ties
    assert improvement(x, y) == pytest.approx(stats.mannwhitneyu(x, y).statistic / (9 * 7))
    assert improvement(x, y) + improvement(y, x) == pytest.approx(1)
    assert improvement(np.ones(3), np.ones(2)) == 0.5


def test_cells_may_have_different_numbers_of_runs_and_are_resampled_apart(rng):
    """Each cell keeps its number of runs; cells without spread give an interval without width."""
    found = stratified_bootstrap([np.zeros(2), np.ones(6)], lambda x: x.mean(-1), rng)
    assert (found.value, found.low, found.high) == (0.75, 0.75, 0.75)
    share, _, _ = performance_profile([np.zeros(2), np.ones(6)], np.array([0.5]), rng)
    assert share == [0.5], "cells count the same in a profile"


def test_intervals_cover_as_often_as_they_say(rng):
    """Means of 20 runs in each of three cells; percentile intervals are a little narrow."""
    covered = 0
    for _ in range(200):
        scores = [rng.normal(center, 1, 20) for center in (0.0, 1.0, 2.0)]
        found = stratified_bootstrap(scores, lambda x: x.mean(-1), rng)
        covered += found.low <= 1.0 <= found.high
    assert 0.88 <= covered / 200 <= 0.99

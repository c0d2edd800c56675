"""How sure estimates and gains are: coverage, and known closed forms."""

import numpy as np
import pytest
from scipy.stats import t as student

from idapt_pl.estimation.intervals import (
    clusters_of,
    covariance,
    deviations_from,
    half_widths,
    paired_gain,
    unknown_variance,
    unseen,
)
from idapt_pl.estimation.least_squares import LeastSquaresFit


@pytest.fixture
def linear_fit():
    """A linear model with unit noise: z = noise at the truth, J known."""
    rng = np.random.default_rng(0)
    J, z = rng.normal(size=(4000, 2)), rng.normal(size=(800, 5))
    return LeastSquaresFit(np.zeros(2), 1.0, J, z)


def test_with_independent_noise_the_covariance_is_that_of_least_squares(linear_fit):
    V = covariance(linear_fit, np.repeat(np.arange(400), 2))
    assert np.diag(V) == pytest.approx(np.diag(np.linalg.inv(linear_fit.J.T @ linear_fit.J)), rel=0.2)


def test_noise_that_lasts_within_episodes_widens_intervals(linear_fit):
    """Eight windows an episode with the same noise and slopes count as one."""
    J = np.repeat(linear_fit.J.reshape(800, 5, 2)[:100], 8, 0).reshape(4000, 2)
    z = np.repeat(linear_fit.z[:100], 8, 0)
    same = LeastSquaresFit(np.zeros(2), 1.0, J, z)
    clustered, not_clustered = (np.diag(covariance(same, c)) for c in (np.repeat(np.arange(100), 8), np.arange(800)))
    assert clustered / not_clustered == pytest.approx([8.0, 8.0], rel=0.05)


def test_what_is_not_known_adds_what_it_would_change(linear_fit):
    shift = np.array([0.3, -0.1])
    change = (linear_fit.J @ shift).reshape(800, 5)
    light = LeastSquaresFit(np.zeros(2), 1.0, linear_fit.J, np.zeros((800, 5)))
    assert unknown_variance(light, [change]) == pytest.approx(shift**2)
    assert unknown_variance(light, [change, change]) == pytest.approx(2 * shift**2)
    assert unknown_variance(light, []).tolist() == [0.0, 0.0]


def test_a_gain_has_the_standard_error_of_a_mean():
    rng = np.random.default_rng(1)
    before, after = rng.normal(3, 1, 200), rng.normal(2, 1, 200)
    gain, error = paired_gain(before, after, np.repeat(np.arange(20), 10))
    assert gain == pytest.approx((before - after).mean())
    assert error == pytest.approx((before - after).std() / np.sqrt(200))


def test_a_gain_in_a_minority_of_episodes_is_not_sure_at_all():
    after = np.repeat([0.0, 1.1, 1.1, 1.1], 5)
    gain, error = paired_gain(np.ones(20), after, np.repeat(np.arange(4), 5))
    assert gain > 0 and error == np.inf
    loss, error = paired_gain(np.ones(20), 2 - after, np.repeat(np.arange(4), 5))
    assert loss < 0 and np.isfinite(error)


def test_episodes_that_a_change_leaves_as_they_are_say_nothing_of_it():
    """A stop that a joint runs into in one episode of four."""
    gain, error = paired_gain(np.ones(20), np.repeat([0.0, 1.0, 1.0, 1.0], 5), np.repeat(np.arange(4), 5))
    assert gain == 0.25 and np.isfinite(error)
    assert paired_gain(np.ones(20), np.ones(20), np.repeat(np.arange(4), 5))[0] == 0


@pytest.mark.parametrize("episodes", [1, 2, 3])
def test_intervals_cover_the_truth_however_few_episodes_there_are(episodes):
    rng, n, covered = np.random.default_rng(episodes), 60, 0
    episode, start = np.repeat(np.arange(episodes), n // episodes), np.tile(np.arange(n // episodes), episodes)
    clusters = clusters_of(episode, start, enough=3)
    quantile = student.ppf(0.975, max(len(np.unique(clusters)) - 1, 2))
    for _ in range(400):
        J, noise = rng.normal(size=(4 * n, 1)), rng.normal(size=4 * n)
        x = np.linalg.lstsq(J, noise, rcond=None)[0]  # the truth is 0
        V = covariance(LeastSquaresFit(x, 1.0, J, (noise - J @ x).reshape(n, 4)), clusters)
        covered += abs(x[0]) < quantile * np.sqrt(V[0, 0])
    assert 0.91 < covered / 400 < 0.99


def test_with_few_clusters_and_several_parameters_the_wider_interval_covers():
    """Seven episodes, four parameters, independent noise: the sandwich alone is often too small by chance."""
    rng, n, p = np.random.default_rng(0), 70, 4
    clusters, wider, sandwich = np.repeat(np.arange(7), n // 7), [], []
    for _ in range(300):
        J, noise = rng.normal(size=(2 * n, p)), rng.normal(size=2 * n)
        x = np.linalg.lstsq(J, noise, rcond=None)[0]  # the truth is 0
        fit = LeastSquaresFit(x, 1.0, J, (noise - J @ x).reshape(n, 2))
        half = half_widths(fit, clusters)
        alone = student.ppf(0.975, 6) * np.sqrt(np.diag(covariance(fit, clusters)))
        assert (half >= alone).all() and (half >= 1.95 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))).all()
        wider.append(np.abs(x) < half), sandwich.append(np.abs(x) < alone)
    assert np.mean(wider) > 0.95
    assert np.mean(wider) > np.mean(sandwich) + 0.01


def test_what_residuals_do_not_show_is_not_known_at_all():
    assert unseen(np.diag([100.0, 1e-6, 0.0])).tolist() == [False, True, True]
    assert deviations_from(np.diag([100.0, 4.0, 0.0])) == pytest.approx([0.1, 0.5, np.inf])
    sum_of_two = np.array([[100.0, 100.0, 0.0], [100.0, 100.0, 0.0], [0.0, 0.0, 4.0]])
    assert deviations_from(sum_of_two) == pytest.approx([np.inf, np.inf, 0.5])

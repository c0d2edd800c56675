"""The ensemble Kalman correction against the Kalman filter's own equations."""

import numpy as np

from idapt_pl.estimation.ensemble_kalman import corrected

PRIOR = np.array([[2.0, 0.9], [0.9, 1.0]])
MEAN = np.array([1.0, -1.0])


def guesses(n, rng):
    return rng.multivariate_normal(MEAN, PRIOR, size=n)


def test_many_guesses_are_corrected_as_kalman_says():
    rng = np.random.default_rng(0)
    cloud, error, reading = guesses(40_000, rng), np.array([0.8]), np.array([1.7])
    H = np.array([[1.0, 0.5]])
    better = corrected(cloud, cloud @ H.T, reading, error, rng)
    S = H @ PRIOR @ H.T + np.diag(error**2)
    K = PRIOR @ H.T @ np.linalg.inv(S)
    np.testing.assert_allclose(better.mean(0), MEAN + K @ (reading - H @ MEAN), atol=0.03)
    np.testing.assert_allclose(np.cov(better.T), PRIOR - K @ H @ PRIOR, atol=0.03)


def test_a_reading_that_cannot_be_moves_the_guesses_less_than_kalman_would():
    rng = np.random.default_rng(1)
    cloud = guesses(20_000, rng)
    near, far = (corrected(cloud, cloud[:, :1], np.array([x]), np.array([0.5]), rng).mean(0) for x in (2.0, 30.0))
    gain = 2.0 / (2.0 + 0.25)
    assert abs(near[0] - (1 + gain * 1.0)) < 0.03
    assert far[0] - 1 < 0.3 * gain * 29


def test_what_does_not_vary_with_the_reading_stays():
    rng = np.random.default_rng(2)
    cloud = guesses(20_000, rng)
    apart = rng.normal(5, 1, size=(20_000, 1))
    better = corrected(np.hstack([cloud, apart]), cloud[:, :1], np.array([0.0]), np.array([0.5]), rng)
    assert abs(better[:, 2].mean() - 5) < 0.03 and abs(better[:, 2].std() - 1) < 0.03

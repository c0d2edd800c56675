"""Whitened residuals of the right model are white."""

import numpy as np
import pytest
from arm import NOISE_Q, NOISE_V, right_model

from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.whitening import whiten, whitener


def test_residuals_of_the_right_model_are_white_after_whitening():
    sim, windows, residual, at = right_model()
    z = whiten(whitener(at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), sim.compared, windows.offsets), residual)
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)
    correlation = np.corrcoef(z.T) - np.eye(z.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(len(z))


def test_what_was_not_measured_does_not_count_and_the_rest_is_white_without_it():
    _, windows, residual, at = right_model()
    elsewhere = residual.copy()
    elsewhere[..., 0] += 1e3
    W = whitener(
        at, Noise(*[np.repeat([NOISE_Q, NOISE_V], 2)] * 2), np.array([False, True, True, True]), windows.offsets
    )
    z = whiten(W, residual)
    assert z.shape[1] == 3 * residual.shape[1] and np.array_equal(z, whiten(W, elsewhere))
    assert np.square(z).mean() == pytest.approx(1.0, abs=0.1)

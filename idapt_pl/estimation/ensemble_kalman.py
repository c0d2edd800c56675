"""The ensemble Kalman filter's correction: what is known of a state by a cloud of guesses, and one more reading."""

from __future__ import annotations

import numpy as np

ROBUST = 2.0
"""Expected errors beyond which a reading counts less: its error is then taken to be as large as would explain it."""


def corrected(
    ensemble: np.ndarray, expected: np.ndarray, reading: np.ndarray, error: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """An ensemble moved towards a reading (Evensen 1994; perturbed readings, Burgers et al. 1998).

    Args:
        ensemble: guesses, (n, d); anything that varies with what is read, past states too.
        expected: what each guess would be read as, (n, m).
        reading: (m,).
        error: its standard deviation, (m,); larger where the reading is off by more than :data:`ROBUST` of what is to
            be expected (Huber's weights).
        rng: of the perturbations.

    Returns:
        The guesses (n, d), with the reading taken in.
    """
    n = len(ensemble)
    about, of_reading = ensemble - ensemble.mean(0), expected - expected.mean(0)
    covariance = of_reading.T @ of_reading / (n - 1)
    surprise = np.abs(reading - expected.mean(0)) / np.sqrt(np.diag(covariance) + np.square(error))
    error = error * np.maximum(1.0, surprise / ROBUST)
    cross = about.T @ of_reading / (n - 1)
    gain = np.linalg.solve(covariance + np.diag(np.square(error)), cross.T)  # transposed, (m, d)
    perturbed = reading + error * rng.normal(size=expected.shape)
    return ensemble + (perturbed - expected) @ gain

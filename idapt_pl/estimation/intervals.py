"""How sure an estimate or a gain is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from idapt_pl.estimation.least_squares import LeastSquaresFit, huber_weights

FEWEST_CLUSTERS = 8
"""Where there are fewer episodes, stretches of them may stand for episodes in intervals."""


UNSEEN = 0.1
"""Sigmas by which a change of a parameter by its scale must move all residuals together, to be measured at all.

Else it may be anything: a centre of mass across the plane in which a pendulum swings.
"""


def influence(fit: LeastSquaresFit) -> tuple[np.ndarray, np.ndarray]:
    """How x / scale moves with residuals, but for the sign: (JᵀWJ)⁻¹, (p, p), and W J, (n rows, p)."""
    weighted = huber_weights(fit.z.ravel())[:, None] * fit.J
    return np.linalg.pinv(fit.J.T @ weighted), weighted


def unseen(information: np.ndarray) -> np.ndarray:
    """Which parameters the residuals do not show, (..., p), by Fisher's information in scales, (..., p, p)."""
    return np.sqrt(np.diagonal(information, axis1=-2, axis2=-1)) < UNSEEN


def deviations_from(information: np.ndarray) -> np.ndarray:
    """Standard deviations of x / scale, (p,), by Fisher's information (p, p).

    Infinite for what it does not show: beside the unseen, what it shows in a sum with others alone.
    """
    out = np.full(len(information), np.inf)
    seen = np.flatnonzero(~unseen(information))
    among = information[np.ix_(seen, seen)]
    floor = 1e-12 * np.trace(among) * np.eye(len(seen))  # a sum of two has no inverse
    out[seen] = np.sqrt(np.diag(np.linalg.inv(among + floor)))
    return np.where(out < 1 / UNSEEN, out, np.inf)


def unknown_variance(fit: LeastSquaresFit, changes: Sequence[np.ndarray]) -> np.ndarray:
    """Variance of x / scale, (p,), by things that are not known and not fitted (Schmidt's consider parameters, 1966).

    Args:
        fit: made as if they were as assumed.
        changes: of the residuals, (n, rows) each, by a standard deviation of each.
    """
    bread, weighted = influence(fit)
    return sum((np.square(bread @ (weighted.T @ c.ravel())) for c in changes), np.zeros(len(bread)))


def half_widths(fit: LeastSquaresFit, clusters: np.ndarray) -> np.ndarray:
    """Half of the 95 % intervals of x / scale, (p,): the wider ones of the sandwich and of noise of unit variance.

    With few clusters the sandwich is often too small by chance, hence the wider of the two (Angrist & Pischke 2009,
    section 8.2). Arguments as of :func:`covariance`.
    """
    sandwich, by_noise = covariance(fit, clusters), influence(fit)[0]
    quantile = student.ppf(0.975, max(len(np.unique(clusters)) - 1, 2))
    one, other = (np.sqrt(np.maximum(np.diag(V), 0)) for V in (sandwich, by_noise))
    return np.maximum(quantile * one, norm.ppf(0.975) * other)


def covariance(fit: LeastSquaresFit, clusters: np.ndarray) -> np.ndarray:
    """Sandwich covariance of x / scale, (p, p): robust to what the noise model gets wrong (Liang & Zeger 1986).

    Args:
        fit: made under independent noise of unit variance.
        clusters: of each window, (n,), within which noise may be dependent (its episode).
    """
    rows = fit.z.shape[1]
    bread, weighted = influence(fit)
    scores = (weighted * fit.z.ravel()[:, None]).reshape(len(fit.z), rows, -1).sum(1)
    names = np.unique(clusters)
    g = np.stack([scores[clusters == c].sum(0) for c in names])
    correction = len(names) / max(len(names) - 1, 1)
    return correction * bread @ (g.T @ g) @ bread


def clusters_of(episode: np.ndarray, start: np.ndarray, enough: int = FEWEST_CLUSTERS) -> np.ndarray:
    """Windows that may err alike, (n,): those of an episode, or of a stretch of it where episodes are few.

    Args:
        episode: of each window, (n,).
        start: its first sample, (n,).
        enough: so many episodes are not few.
    """
    names = np.unique(episode)
    if len(names) >= enough:
        return episode
    parts, out = -(-FEWEST_CLUSTERS // len(names)), np.zeros(len(episode), int)
    for k, e in enumerate(names):
        rows = np.flatnonzero(episode == e)
        rank = np.argsort(np.argsort(start[rows], kind="stable"), kind="stable")
        out[rows] = k * parts + rank * parts // len(rows)
    return out


def paired_gain(
    before: np.ndarray, after: np.ndarray, clusters: np.ndarray, *, touched: float = 0.0
) -> tuple[float, float]:
    """Mean of before - after over windows, and its standard error.

    Windows do not overlap, so their noise is independent. That some episodes show an effect more than others is
    no reason to doubt it; if it helps in fewer than half of those that it changes, the error returned is infinite.

    Args:
        before: loss of each window, (n,).
        after: the same, with the change, (n,).
        clusters: episode of each window, (n,).
        touched: what it changes in the mean of an episode must be more than this share of what it changes where it
            changes most, to count as change: what else is in a model is refitted with it, and that changes a little
            everywhere.
    """
    gain = before - after
    in_episodes = np.array([gain[clusters == c].mean() for c in np.unique(clusters)])
    changed = in_episodes[np.abs(in_episodes) > touched * np.abs(in_episodes).max()]
    helped = float(np.mean(changed > 0)) if len(changed) else 0.0
    error = float(gain.std() / np.sqrt(len(gain)))
    return float(gain.mean()), error if helped >= 0.5 or gain.mean() <= 0 else float("inf")

"""Is a parameter constant in time? Scores of windows, functions of time, and a bootstrap over stretches.

Every window has a score (slope of its loss) and an information for a parameter. A parameter that changes in time is a
regression of scores on functions of time. Whether it is more than chance says a wild bootstrap: scores of whole
stretches of the recordings change their sign at random (Rademacher; Cameron, Gelbach & Miller 2008), so that what
windows of a stretch have in common is no evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.estimation.least_squares import huber_weights

SIGN_FLIPS = 999
"""Of the bootstrap."""

FEWEST_STRETCHES = 10
"""Stretches that a test takes; episodes are halved or quartered until there are as many."""


@dataclass(frozen=True, eq=False)
class WindowTimes:
    """Windows in the order of the recordings: their episode, start in it [s], and place in fit and held-out ones."""

    episode: np.ndarray
    time: np.ndarray
    order: np.ndarray


@dataclass(frozen=True)
class TimeShape:
    """How a parameter may change.

    Attributes:
        kind: ``drift_within``, ``decay_within``, ``step_within`` (the same in every episode), ``drift_over``,
            ``step_over`` (the recordings in their order).
        f: function of time at every window, (n,).
        at: time constant of a decay, or time of a step, s; NaN for drifts.
        episode: in which a step over the recordings lies; -1 for others.
        cost: parameters, the sought time among them.
    """

    kind: str
    f: np.ndarray
    at: float
    episode: int
    cost: int


@dataclass(frozen=True, eq=False)
class WindowScores:
    """Scores of a parameter, window by window in the order of the recordings.

    Attributes:
        score: d loss / d parameter, (n,); the best constant change taken out.
        information: (n,).
        constant: by how much the best constant value is above the one that the scores were taken at.
    """

    score: np.ndarray
    information: np.ndarray
    constant: float


def time_clusters(at: WindowTimes) -> np.ndarray:
    """Number of the stretch that each window is in: an episode, or as large a part of one as makes enough of them."""
    parts = next((k for k in (1, 2, 4) if k * len(np.unique(at.episode)) >= FEWEST_STRETCHES), 4)
    out = np.zeros(len(at.episode), int)
    for n, e in enumerate(np.unique(at.episode)):
        rows = np.flatnonzero(at.episode == e)
        out[rows] = parts * n + np.arange(len(rows)) * parts // len(rows)
    return out


def scores_of(z: np.ndarray, others: Sequence[np.ndarray], own: np.ndarray) -> WindowScores:
    """Scores of a parameter with slopes ``own`` (n, rows), the others and its own best constant value fitted."""
    root = np.sqrt(huber_weights(z))
    left, column = (root * z).ravel(), (root * own).ravel()
    if others:
        beside = np.stack([(root * o).ravel() for o in others], 1)
        left, column = (v - beside @ np.linalg.lstsq(beside, v, rcond=1e-10)[0] for v in (left, column))
    constant = -float(column @ left) / max(float(column @ column), 1e-300)
    score = (column * (left + constant * column)).reshape(len(z), -1).sum(1)
    information = np.square(column).reshape(len(z), -1).sum(1) + 1e-12
    return WindowScores(score, information, constant)


def dispersion_of(score: np.ndarray, information: np.ndarray, clusters: np.ndarray) -> float:
    """How many times as large as by their information squared scores are, at least 1: by the median over clusters."""
    sums = np.array([[x[clusters == c].sum() for x in (score, information)] for c in np.unique(clusters)])
    return max(1.0, float(np.median(sums[:, 0] ** 2 / sums[:, 1]) / 0.455))


def time_shapes(at: WindowTimes) -> Iterator[TimeShape]:
    """Functions of time that a parameter may follow."""
    longest, n = float(at.time.max()), len(at.time)
    order = np.arange(n)
    yield TimeShape("drift_within", at.time, np.nan, -1, 1)
    for share in (0.1, 0.25, 0.6):
        yield TimeShape("decay_within", np.exp(-at.time / (share * longest)), share * longest, -1, 2)
    for share in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        yield TimeShape("step_within", (at.time > share * longest).astype(float), share * longest, -1, 2)
    if len(np.unique(at.episode)) > 3:
        yield TimeShape("drift_over", at.episode.astype(float), np.nan, -1, 1)
    for k in np.unique(np.linspace(0.1 * n, 0.9 * n, 33).astype(int)):
        yield TimeShape("step_over", (order >= k).astype(float), float(at.time[k]), int(at.episode[k]), 2)


def merits(w: WindowScores, shapes: Sequence[TimeShape], clusters: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Gain of each shape in log likelihood (twice, by BIC) over a constant, (draws, shapes).

    Args:
        w: scores of a parameter.
        shapes: to try.
        clusters: number of each window's stretch, (n,), from 0 on.
        signs: of the stretches, (draws, stretches).
    """
    n, total = len(w.score), float(w.information.sum())
    F = np.stack([s.f - (w.information @ s.f) / total for s in shapes], 1)
    by_cluster = np.zeros((signs.shape[1], len(shapes)))
    np.add.at(by_cluster, clusters, w.score[:, None] * F)
    gain = np.square(signs @ by_cluster) / (w.information @ np.square(F))
    most = max(float((np.square(w.score) / w.information).sum()), 1e-300)  # 0 of a parameter that does nothing
    explained = np.clip(gain / most, 0.0, 1 - 1e-9)
    return -n * np.log1p(-explained) - np.log(n) * np.array([s.cost for s in shapes])


def constancy_test(
    parameters: Sequence[WindowScores], shapes: Sequence[TimeShape], clusters: np.ndarray, seed: int
) -> tuple[list[TimeShape], list[float]]:
    """The best shape for each parameter by BIC, and how likely any constant one would look as changing as that."""
    numbers, at = np.unique(clusters, return_inverse=True)
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (SIGN_FLIPS, len(numbers)))
    found = [merits(w, shapes, at, np.ones((1, len(numbers))))[0] for w in parameters]
    chance = np.max([merits(w, shapes, at, signs).max(1) for w in parameters], axis=0)
    p = [float(1 + np.sum(chance >= m.max() - 1e-9)) / (SIGN_FLIPS + 1) for m in found]
    return [shapes[int(np.argmax(m))] for m in found], p

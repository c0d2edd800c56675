"""Effects that change while they are recorded: is a parameter the same throughout, does it drift, or step?

Every window has a score (slope of its loss) and an information for each parameter, both by simulation. A parameter that
changes in time is a regression of scores on functions of time. Whether it is more than chance says a wild bootstrap:
scores of whole stretches of the recordings change their sign at random (Rademacher; Cameron, Gelbach & Miller 2008), so
that what windows of a stretch have in common is no evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from idapt_pl.diagnosis.context import SearchContext
from idapt_pl.diagnosis.law_candidate import LawCandidate
from idapt_pl.diagnosis.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.wording import unit_at
from idapt_pl.estimation.least_squares import huber_weights

LEVEL = 0.01
"""Share of recordings of what is constant in which a change is reported, over all parameters and kinds of change."""

DRAWS = 999
"""Of the bootstrap."""

FEWEST_CLUSTERS = 10
"""Stretches that a test takes; episodes are halved or quartered until there are as many."""

LEAST_CHANGE = 0.1
"""Of the parameter's size (or, near 0, of its scale) that a change must come to."""

MUCH = 0.3
"""Share of what is left that a change over the recordings must explain, so that no law is looked for."""

STRETCHES = 6
"""Within an episode, for which the values are shown where it changes there."""


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
        dispersion: by how much stretches differ more than noise would make them, at least 1.
    """

    score: np.ndarray
    information: np.ndarray
    dispersion: float


@dataclass(frozen=True)
class ChangeFinding:
    """A parameter of an effect that changes.

    Attributes:
        effect, target, parameter: which.
        unit: of it.
        kind: how it changes, as of :class:`TimeShape`.
        first, last: its value at the beginning and at the end of the change.
        at: time constant or time of a step, s; None for drifts.
        episode: in which a step over the recordings lies; None for others.
        p: of a parameter that is constant to look like this.
        removed_share: of the squared error of all windows above the noise floor that the change removes.
        series: stretches: where (an episode's number, or seconds), value, half of the 95 % interval.
    """

    effect: str
    target: str
    parameter: str
    unit: str
    kind: str
    first: float
    last: float
    at: float | None
    episode: int | None
    p: float
    removed_share: float
    series: Sequence[tuple[float, float, float]]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        values = dict(vars(self))
        values["series"] = [{"at": a, "value": v, "half_width": h} for a, v, h in self.series]
        return values


@dataclass(frozen=True)
class ChangeReport:
    """What the test for constancy came to: how many parameters were tested, and those that change."""

    tested: int
    found: Sequence[ChangeFinding]

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {"tested": self.tested, "found": [f.to_dict() for f in self.found]}


def find_changes(context: SearchContext, state: SearchState) -> ChangeReport | None:
    """Which parameters of the accepted effects change; None where there is nothing to test, or too little."""
    effects = [a for a in state.accepted if not isinstance(a.candidate, LawCandidate)]
    at = windows_in_order(context, state)
    clusters = stretches_of(at)
    if not effects or len(np.unique(clusters)) < FEWEST_CLUSTERS:
        return None
    context.progress("does it change?", 0.9)
    z, J = residual_slopes_of(context, state, at.order)
    names = [(a, k) for a in state.accepted for k in range(a.candidate.size)]
    tested = [(i, a, k) for i, (a, k) in enumerate(names) if a in effects and k < (a.candidate.strength or 99)]
    scores = {i: scores_of(z, J, i, clusters) for i, _, _ in tested}
    shapes = [s for s in time_shapes(context, at) if np.ptp(s.f) > 0]
    best, p = test_constancy([scores[i] for i, _, _ in tested], shapes, clusters, context.seed)
    found = []
    for (i, a, k), shape, chance in zip(tested, best, p, strict=True):
        if chance <= LEVEL and (finding := describe(context, at, scores[i], shape, a, k, chance, z)):
            found.append(finding)
    strongest = sorted(found, key=lambda f: -f.removed_share)
    return ChangeReport(len(tested), [f for f in strongest if f.removed_share > 0.25 * strongest[0].removed_share])


def changes_over_recordings(changes: ChangeReport | None) -> bool:
    """Whether a change from recording to recording explains much of what is left: no law within one can."""
    found = changes.found if changes is not None else ()
    return any(f.kind in ("drift_over", "step_over") and f.removed_share > MUCH for f in found)


@dataclass(frozen=True, eq=False)
class WindowTimes:
    """Windows in the order of the recordings: their episode, start in it [s], and place in fit and held-out ones."""

    episode: np.ndarray
    time: np.ndarray
    order: np.ndarray


def windows_in_order(context: SearchContext, state: SearchState) -> WindowTimes:
    """All windows, fitted and held out."""
    both = [state.windows.fit.windows, state.windows.held_out.windows]
    episode, start = (np.concatenate([getattr(w, name) for w in both]) for name in ("episode", "start"))
    order = np.lexsort((start, episode))
    data = context.sim.data
    time = np.array([data[e].time[s] - data[e].time[0] for e, s in zip(episode, start, strict=True)])
    return WindowTimes(episode[order], time[order], order)


def stretches_of(at: WindowTimes) -> np.ndarray:
    """Number of the stretch that each window is in: an episode, or as large a part of one as makes enough of them."""
    parts = next((k for k in (1, 2, 4) if k * len(np.unique(at.episode)) >= FEWEST_CLUSTERS), 4)
    out = np.zeros(len(at.episode), int)
    for n, e in enumerate(np.unique(at.episode)):
        rows = np.flatnonzero(at.episode == e)
        out[rows] = parts * n + np.arange(len(rows)) * parts // len(rows)
    return out


def residual_slopes_of(context: SearchContext, state: SearchState, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residuals of all windows in order, (n, rows), and their slopes by every parameter, (n, rows, p)."""
    splits = (state.windows.fit, state.windows.held_out)

    def all_windows(s: SearchState) -> np.ndarray:
        return np.concatenate([context.whitened(split, s.effects) for split in splits])[order]

    z, slopes = all_windows(state), []
    for n, a in enumerate(state.accepted):
        for k in range(a.candidate.size):
            h = 0.05 * a.candidate.scale[k]
            h = -h if a.x[k] + h > a.candidate.bounds()[1][k] else h
            x = [e.copy() for e in state.estimates]
            x[n][k] += h
            slopes.append((all_windows(state.with_estimates(x)) - z) / h)
    return z, np.stack(slopes, -1)


def scores_of(z: np.ndarray, J: np.ndarray, i: int, clusters: np.ndarray) -> WindowScores:
    """Scores of parameter ``i``, the other parameters and its own best constant value fitted."""
    root = np.sqrt(huber_weights(z))[..., None]
    weighted, left = (root * J).reshape(-1, J.shape[-1]), (root[..., 0] * z).ravel()
    left = left - weighted @ np.linalg.lstsq(weighted, left, rcond=1e-10)[0]
    others = np.delete(weighted, i, 1)
    own = weighted[:, i]
    own = own - others @ np.linalg.lstsq(others, own, rcond=1e-10)[0] if others.size else own
    score = (own * left).reshape(len(z), -1).sum(1)
    information = np.square(own).reshape(len(z), -1).sum(1) + 1e-12
    by_cluster = np.array([[x[clusters == c].sum() for x in (score, information)] for c in np.unique(clusters)])
    return WindowScores(
        score, information, max(1.0, float(np.median(by_cluster[:, 0] ** 2 / by_cluster[:, 1]) / 0.455))
    )


def time_shapes(context: SearchContext, at: WindowTimes) -> Iterator[TimeShape]:
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


def gains(scores: np.ndarray, information: np.ndarray, shapes: Sequence[TimeShape]) -> np.ndarray:
    """What each shape explains beyond a constant: (draws, n) scores to (draws, shapes)."""
    F = np.stack([s.f - (information @ s.f) / information.sum() for s in shapes], 1)
    return np.square(scores @ F) / (information @ np.square(F))


def test_constancy(
    parameters: Sequence[WindowScores], shapes: Sequence[TimeShape], clusters: np.ndarray, seed: int
) -> tuple[list[TimeShape], list[float]]:
    """The best shape for each parameter by BIC, and how likely any constant one would look as changing as that."""
    rng, numbers = np.random.default_rng(seed), np.unique(clusters)
    signs = rng.choice((-1.0, 1.0), (DRAWS, len(numbers)))[:, np.searchsorted(numbers, clusters)]
    cost = np.log(len(numbers)) * np.array([s.cost for s in shapes])
    merit = [gains(w.score[None], w.information, shapes)[0] / w.dispersion - cost for w in parameters]
    chance = np.max(
        [(gains(signs * w.score, w.information, shapes) / w.dispersion - cost).max(1) for w in parameters], axis=0
    )
    p = [float(1 + np.sum(chance >= m.max() - 1e-9)) / (DRAWS + 1) for m in merit]
    return [shapes[int(np.argmax(m))] for m in merit], p


def describe(
    context: SearchContext,
    at: WindowTimes,
    w: WindowScores,
    s: TimeShape,
    a: AcceptedEffect,
    k: int,
    p: float,
    z: np.ndarray,
) -> ChangeFinding | None:
    """A change in numbers; None where it is too small to matter."""
    c, value = a.candidate, float(a.x[k])
    f = s.f - (w.information @ s.f) / w.information.sum()
    slope = -float(w.score @ f) / float(w.information @ np.square(f))
    ends = value + slope * (f[[np.argmin(at.time), np.argmax(at.time)]] if "within" in s.kind else f[[0, -1]])
    size = max(abs(value), abs(value - c.nominal[k]), c.scale[k])
    if abs(ends[1] - ends[0]) < LEAST_CHANGE * size:
        return None
    removable = max(float(np.minimum(np.square(z), 36).sum()) - z.size, 1e-9)
    gain = float(np.square(w.score @ f) / (w.information @ np.square(f)))
    low, high = (float(b[k]) for b in c.bounds())
    first, last = (float(f"{np.clip(e, low, high):.4g}") for e in ends)
    return ChangeFinding(
        c.kind.name, c.target, c.names[k], unit_at(context.sim.model, c.target, c.units()[k]), s.kind, first, last,
        None if np.isnan(s.at) else round(s.at, 4), None if s.episode < 0 else s.episode, p,
        round(min(gain / removable, 1.0), 4), series_of(at, w, s, value),
    )  # fmt: skip


def series_of(at: WindowTimes, w: WindowScores, s: TimeShape, value: float) -> list[tuple[float, float, float]]:
    """Values in stretches: of time in the episode, or episode by episode."""
    bins = at.episode.astype(float)
    places = np.unique(bins)
    if "within" in s.kind:
        edges = np.linspace(0, at.time.max() + 1e-9, STRETCHES + 1)
        bins = np.digitize(at.time, edges) - 1.0
        places = np.unique(bins)
    out = []
    for b in places:
        rows = bins == b
        information = float(w.information[rows].sum())
        where = float(at.time[rows].mean()) if "within" in s.kind else float(b)
        half = 1.96 * np.sqrt(w.dispersion / information)
        out.append((round(where, 4), value - float(w.score[rows].sum()) / information, float(half)))
    return out

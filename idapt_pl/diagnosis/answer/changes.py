"""Effects that change while they are recorded: is a parameter the same throughout, does it drift, or step?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from idapt_pl.diagnosis.answer.change_statistics import (
    FEWEST_STRETCHES,
    TimeShape,
    WindowScores,
    WindowTimes,
    constancy_test,
    dispersion_of,
    scores_of,
    time_clusters,
    time_shapes,
)
from idapt_pl.diagnosis.answer.parameters_in_time import (
    ParameterInTime,
    accepted_parameters,
    all_windows,
    other_candidates,
    windows_in_order,
)
from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.rounds.measurement import measure_intervals
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState, refit_accepted
from idapt_pl.effects.wording import unit_at
from idapt_pl.estimation.least_squares import robust_loss

LEVEL = 0.01
"""Share of recordings of what is constant in which a change is reported, over all parameters and kinds of change."""

LEAST_CHANGE = 0.1
"""Of the parameter's size that a change must come to; and of its scale, if it explains little of what is left."""

MUCH_LEFT = 0.2
"""Squared error above the noise, in times of the noise's, that something must be left of for its share to tell."""

MOST_OF_REST = 0.3
"""Share of what is left that a change over the recordings must explain, so that no law is looked for."""

RIVALS, PIECES, RIVAL_BETTER = 4, 4, 0.03
"""Parameters tried in the place of an accepted one that changes, in how many stretches those that drift get a value of
their own, and the share of the loss by which one must be better."""

SIMULATED_PIECES = 8
"""Values that stand for a change that is simulated."""

SHOWN_STRETCHES = 6
"""Within an episode, for which the values are shown where it changes there."""


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
        removed_share: of the squared error of all windows above the noise floor that it removes; by slopes while
            changes are compared, by simulation in the end.
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


@dataclass(frozen=True, eq=False)
class Change:
    """What was found, of which parameter, and how it follows time."""

    finding: ChangeFinding
    parameter: ParameterInTime
    shape: TimeShape


def find_changes(context: SearchContext, state: SearchState) -> tuple[ChangeReport | None, SearchState]:
    """Which parameters change: of the accepted effects, and where much is left, of other candidates.

    Returns:
        The report, None where there is nothing to test, or too little to tell; and the state, without an effect that
        was accepted as a constant stand-in for another one that changes.
    """
    at = windows_in_order(context, state)
    clusters = time_clusters(at)
    if len(np.unique(clusters)) < FEWEST_STRETCHES:
        return None, state
    context.progress("does it change?", 0.9)
    z = all_windows(context, state, state.effects, at.order)
    accepted = accepted_parameters(context, state, at.order)
    shapes = [s for s in time_shapes(at) if np.ptp(s.f) > 0]
    found = changing_ones(context, state, at, z, accepted, accepted, shapes, clusters)
    tested = len(accepted)
    if found and np.mean(robust_loss(z)) > LEFT_OVER:
        more, rival, rest = rival_change(context, state, at, found[0], shapes, clusters)
        tested += more
        if rival is not None:
            rest = measure_intervals(context, rest)  # the others were fitted anew
            return ChangeReport(tested, [simulated(context, rest, at, rival)]), rest
    if np.mean(robust_loss(z)) > LEFT_OVER and sum(f.finding.removed_share for f in found[:1]) < MOST_OF_REST:
        others = other_candidates(context, state, at.order)
        tested += len(others)
        every = [*changing_ones(context, state, at, z, others, accepted, shapes, clusters)[:1], *found]
        found = [f for f in every if f.finding.removed_share > MOST_OF_REST] or found[:1]
    told = [simulated(context, state, at, f) for f in found]
    return (ChangeReport(tested, told) if tested else None), state


def rival_change(
    context: SearchContext, state: SearchState, at: WindowTimes, own: Change, shapes: Sequence[TimeShape],
    clusters: np.ndarray,
) -> tuple[int, Change | None, SearchState]:  # fmt: skip
    """Another parameter whose change explains clearly more in the place of an accepted effect that changes.

    Returns:
        How many were tested, the best of them (None where the accepted effect is best), and the state without that one.
    """
    assert own.parameter.accepted is not None, "one of the accepted effects"
    rest = refit_accepted(context, state.without(own.parameter.accepted))
    z = all_windows(context, rest, rest.effects, at.order)
    others = other_candidates(context, rest, at.order)
    beside = accepted_parameters(context, rest, at.order)
    rivals = changing_ones(context, rest, at, z, others, beside, shapes, clusters)[:RIVALS]
    losses = context.sim.side_by_side.map(lambda r: loss_in_pieces(context, rest, at, r), rivals)
    best = int(np.argmin(losses)) if rivals else -1
    if best < 0 or rivals[best].parameter.candidate.label == own.parameter.candidate.label:
        return len(others), None, state
    if losses[best] > (1 - RIVAL_BETTER) * loss_in_pieces(context, state, at, own):
        return len(others), None, state
    return len(others), rivals[best], rest


def loss_in_pieces(context: SearchContext, state: SearchState, at: WindowTimes, change: Change) -> float:
    """Loss of the fitted windows by simulation, with a value of the parameter for each stretch of time."""
    f, split, t = change.shape.f, state.windows.fit, change.parameter
    edges = [0.5] if "step" in change.shape.kind else np.quantile(f, np.linspace(0, 1, PIECES + 1)[1:-1])
    piece = np.digitize(f, edges)
    rest = state if t.accepted is None else state.without(t.accepted)
    total = 0.0
    for k in np.unique(piece):
        chosen = np.sort(at.order[(piece == k) & (at.order < len(split.windows))])
        if not len(chosen):
            continue
        value = refit_alone(context, state, t, at, piece == k, t.value)
        x = np.array(t.candidate.nominal if t.accepted is None else t.accepted.x, float)
        one = t.candidate.with_one_free(t.k, x).effect([value])
        total += float(robust_loss(context.whitened(split[chosen], (*rest.effects, one))).sum())
    return total


def simulated(context: SearchContext, state: SearchState, at: WindowTimes, change: Change) -> ChangeFinding:
    """What was found by slopes, by simulation: ends of what drifts or decays, and the share of the error removed."""
    f, t, found = change.shape.f, change.parameter, change.finding
    begin, end = f[[np.argmin(at.time), np.argmax(at.time)]] if "within" in found.kind else f[[0, -1]]
    alike = [np.flatnonzero(f == v) for v in np.unique(f)]
    pieces = alike if len(alike) <= SIMULATED_PIECES else np.array_split(np.argsort(f), SIMULATED_PIECES)
    middle, first, last = np.array([f[rows].mean() for rows in pieces]), found.first, found.last
    if "step" not in found.kind:
        rows_of = [np.isin(np.arange(len(f)), rows) for rows in pieces]
        guesses = first + (last - first) * (middle - begin) / (end - begin)
        values = [refit_alone(context, state, t, at, r, v) for r, v in zip(rows_of, guesses, strict=True)]
        line = np.polynomial.Polynomial.fit(middle, values, 1)
        first, last = (float(f"{v:.4g}") for v in np.clip(line([begin, end]), *(b[t.k] for b in t.candidate.bounds())))
    x = np.array(t.candidate.nominal if t.accepted is None else t.accepted.x, float)
    rest = state if t.accepted is None else state.without(t.accepted)
    left = 0.0
    for rows, where in zip(pieces, (middle - begin) / (end - begin), strict=True):
        effect = t.candidate.with_one_free(t.k, x).effect([first + (last - first) * where])
        z = all_windows(context, state, (*rest.effects, effect), at.order[rows])
        left += float(np.minimum(np.square(z), 36).sum()) - z.size
    removable = removable_error(all_windows(context, state, state.effects, at.order))
    share = round(float(np.clip(1 - left / removable, 0, 1)), 4)
    return replace(found, first=first, last=last, removed_share=share)


def removable_error(z: np.ndarray) -> float:
    """Squared error of whitened residuals above the noise, each bounded."""
    return max(float(np.minimum(np.square(z), 36).sum()) - z.size, 1e-9)


def changing_ones(
    context: SearchContext, state: SearchState, at: WindowTimes, z: np.ndarray, tested: Sequence[ParameterInTime],
    accepted: Sequence[ParameterInTime], shapes: Sequence[TimeShape], clusters: np.ndarray,
) -> list[Change]:  # fmt: skip
    """Those of some parameters that surely change, what explains most first; accepted ones are fitted beside each."""
    if not tested:
        return []
    scores = [scores_of(z, [t.slopes for t in accepted if t is not own], own.slopes) for own in tested]
    best, p = constancy_test(scores, shapes, clusters, context.seed)
    found = [
        Change(finding, t, shape)
        for t, w, shape, chance in zip(tested, scores, best, p, strict=True)
        if chance <= LEVEL and (finding := describe(context, state, at, w, shape, t, chance, z))
    ]
    found.sort(key=lambda f: -f.finding.removed_share)
    return [f for f in found if f.finding.removed_share > 0.25 * found[0].finding.removed_share]


def changes_over_recordings(changes: ChangeReport | None) -> bool:
    """Whether a change from recording to recording explains much of what is left: no law within one can."""
    found = changes.found if changes is not None else ()
    return any(f.kind in ("drift_over", "step_over") and f.removed_share > MOST_OF_REST for f in found)


def describe(
    context: SearchContext, state: SearchState, at: WindowTimes, w: WindowScores, s: TimeShape, t: ParameterInTime,
    p: float, z: np.ndarray,
) -> ChangeFinding | None:  # fmt: skip
    """A change in numbers; None where it is too small to matter."""
    c, k, value = t.candidate, t.k, t.value + w.constant
    f = s.f - (w.information @ s.f) / w.information.sum()
    slope = -float(w.score @ f) / float(w.information @ np.square(f))
    ends = value + slope * (f[[np.argmin(at.time), np.argmax(at.time)]] if "within" in s.kind else f[[0, -1]])
    if "step" in s.kind:
        ends = np.array(
            [refit_alone(context, state, t, at, s.f == side, e) for side, e in zip((0, 1), ends, strict=True)]
        )
    low, high = (float(b[k]) for b in c.bounds())
    ends = np.clip(ends, low, high)
    removable = removable_error(z)
    gain = float(np.square(w.score @ f) / (w.information @ np.square(f)))
    gain += w.constant**2 * float(w.information.sum()) * (t.accepted is None)
    change, size = abs(ends[1] - ends[0]), max(abs(value), abs(value - c.nominal[k]))
    matters = change > LEAST_CHANGE * c.scale[k] or gain > MOST_OF_REST * max(removable, MUCH_LEFT * z.size)
    if change < LEAST_CHANGE * size or not matters:
        return None
    first, last = (float(f"{e:.4g}") for e in ends)
    return ChangeFinding(
        effect=c.kind.name,
        target=c.target,
        parameter=c.names[k],
        unit=unit_at(context.sim.model, c.target, c.units()[k]),
        kind=s.kind,
        first=first,
        last=last,
        at=None if np.isnan(s.at) else round(s.at, 4),
        episode=None if s.episode < 0 else s.episode,
        p=p,
        removed_share=round(min(gain / removable, 1.0), 4),
        series=series_of(
            at, w, s, value, dispersion_of(w.score + slope * f * w.information, w.information, at.episode)
        ),
    )


def refit_alone(
    context: SearchContext, state: SearchState, t: ParameterInTime, at: WindowTimes, rows: np.ndarray, guess: float
) -> float:
    """The parameter by simulation of some of the fitted windows alone, the other effects as they are."""
    split = state.windows.fit
    chosen = np.sort(at.order[rows & (at.order < len(split.windows))])
    if len(chosen) < 5:
        return guess
    rest = state if t.accepted is None else state.without(t.accepted)
    x = np.array(t.candidate.nominal if t.accepted is None else t.accepted.x, float)
    one = t.candidate.with_one_free(t.k, x)
    return float(context.fit(split[chosen], rest.effects, [one], [np.array([guess])], 3).x[0][0])


def series_of(
    at: WindowTimes, w: WindowScores, s: TimeShape, value: float, dispersion: float
) -> list[tuple[float, float, float]]:
    """Values in stretches: of time in the episode, or episode by episode; ``dispersion`` is that around the shape."""
    bins = at.episode.astype(float)
    places = np.unique(bins)
    if "within" in s.kind:
        edges = np.linspace(0, at.time.max() + 1e-9, SHOWN_STRETCHES + 1)
        bins = np.digitize(at.time, edges) - 1.0
        places = np.unique(bins)
    out = []
    for b in places:
        rows = bins == b
        information = float(w.information[rows].sum())
        where = float(at.time[rows].mean()) if "within" in s.kind else float(b)
        half = 1.96 * np.sqrt(dispersion / information)
        out.append((round(where, 4), value - float(w.score[rows].sum()) / information, float(half)))
    return out

"""What every parameter does to the windows of all recordings, in their order in time: slopes for tests of constancy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.answer.change_statistics import WindowTimes
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.diagnosis.state.search_windows import affordable_windows
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.world import ExternalForce
from idapt_pl.prediction.simulator import Effects

WINDOWS_LOOKED_AT = 240
"""Windows that are looked at, at most."""

UNTESTED = (SensingEffect, ExternalForce)  # not taken to change where they are not accepted


@dataclass(frozen=True, eq=False)
class ParameterInTime:
    """A parameter whose constancy is tested.

    Attributes:
        candidate: whose it is.
        k: its number there.
        value: the best constant one.
        slopes: d whitened residual / d parameter of all windows in order, (n, rows).
        accepted: the accepted effect that it belongs to; None for a candidate that is not accepted.
    """

    candidate: Candidate
    k: int
    value: float
    slopes: np.ndarray
    accepted: AcceptedEffect | None


def windows_in_order(context: SearchContext, state: SearchState) -> WindowTimes:
    """All windows, fitted and held out; of many every so many."""
    both = [state.windows.fit.windows, state.windows.held_out.windows]
    episode, start = (np.concatenate([getattr(w, name) for w in both]) for name in ("episode", "start"))
    order = np.lexsort((start, episode))
    data = context.sim.data
    time = np.array([data[e].time[s] - data[e].time[0] for e, s in zip(episode, start, strict=True)])
    most = WINDOWS_LOOKED_AT * affordable_windows(context, state.fixed)
    order = order[:: int(np.ceil(len(order) / most))]
    return WindowTimes(episode[order], time[order], order)


def all_windows(context: SearchContext, state: SearchState, effects: Effects, order: np.ndarray) -> np.ndarray:
    """Whitened residuals of fitted and held-out windows in order, (n, rows)."""
    fit, held_out = state.windows.fit, state.windows.held_out
    first = np.repeat([0, len(fit.windows)], [len(fit.windows), len(held_out.windows)])[order]
    parts = [(split, np.flatnonzero(first == k)) for split, k in ((fit, 0), (held_out, len(fit.windows)))]
    z = [context.whitened(split[order[rows] - first[rows]], effects) for split, rows in parts if len(rows)]
    return np.concatenate(z)[np.argsort(np.concatenate([rows for _, rows in parts]), kind="stable")]


def what_changes(context: SearchContext, state: SearchState, order: np.ndarray) -> Callable[[Effects], np.ndarray]:
    """What other effects change in the whitened residuals of windows in order, (n, rows); coarsely, where that does."""
    step = context.coarse_step(state.windows.fit, state.effects)

    def left(effects: Effects) -> np.ndarray:
        return all_windows(context, state, context.with_coarse_numerics(effects, step), order)

    base = left(state.effects)
    return lambda effects: left(effects) - base


def accepted_parameters(context: SearchContext, state: SearchState, order: np.ndarray) -> list[ParameterInTime]:
    """Those parameters of accepted effects that say how strong they are."""
    change, out = what_changes(context, state, order), []
    for n, a in enumerate(state.accepted):
        for k in range(a.candidate.strength or a.candidate.size):
            x = [e.copy() for e in state.estimates]
            x[n][k] += (h := small_step(a.candidate, a.x, k))
            slopes = change(state.with_estimates(x).effects) / h
            out.append(ParameterInTime(a.candidate, k, float(a.x[k]), slopes, a))
    return out


def other_candidates(context: SearchContext, state: SearchState, order: np.ndarray) -> list[ParameterInTime]:
    """The first parameter of every candidate that is not accepted: at its nominal value."""
    change = what_changes(context, state, order)
    known = {a.candidate.label for a in state.accepted}

    def first_parameter(c: Candidate) -> ParameterInTime | None:
        x = np.array(c.nominal, float)
        taken_back = any(a.candidate.overlaps(c) for a in state.accepted)  # another value of the same element
        base = change((*state.effects, c.effect(x))) if taken_back else 0.0
        x[0] += (h := small_step(c, x, 0))
        slopes = (change((*state.effects, c.effect(x))) - base) / h
        told = np.linalg.norm(slopes) * c.scale[0] > 1.0
        return ParameterInTime(c, 0, float(c.nominal[0]), slopes, None) if told else None

    others = [c for c in context.candidates if c.label not in known and not issubclass(c.kind, UNTESTED)]
    return [p for p in context.sim.side_by_side.map(first_parameter, others) if p is not None]


def small_step(c: Candidate, x: np.ndarray, k: int) -> float:
    """A step of a parameter for a slope, inside its bounds."""
    h = 0.05 * c.scale[k]
    return -h if x[k] + h > c.bounds()[1][k] else h

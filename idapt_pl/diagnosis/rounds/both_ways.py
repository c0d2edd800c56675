"""Where few or none of the held-out windows show an effect: fitted to others, and judged on those of the fit as well.

An end stop that a joint meets in one held-out episode of four takes all of the error away there, and that is one number
to judge by; or it is met in none of them. Each window is judged by a fit that has not seen it (cross-fitting).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import WhitenedWindows

STEPS_THE_OTHER_WAY = 5
"""Of a fit."""
MOST_OF_THE_REST = 0.5
"""Share of what is left above noise that it must take away on the held-out windows."""

TOUCHED = 0.05
"""Share of the change in what shows an effect most, an episode or a window, up to which others do not show it."""
MOST_COUNTED = 10.0
"""Loss, in units of the noise (squared), that no window loses by chance."""
NEXT_TO_NOTHING = 0.5
"""Change of the loss of any held-out window, below which it is looked whether others show the effect."""


def gain_on_all(
    context: SearchContext,
    state: SearchState,
    candidates: Sequence[Candidate],
    x: Sequence[np.ndarray],
    without: Effects,
    held_out: tuple[np.ndarray, np.ndarray],
    sure: float,
) -> tuple[float, float]:
    """What an effect gains, and the standard error of that; on all windows where the held-out ones cannot tell.

    They cannot where it gains much there and is not sure, or where it changes nothing in any of them.

    Args:
        context: of the search.
        state: with the windows.
        candidates: effects of the model with it.
        x: their parameters, fitted to the windows that fits are made on.
        without: effects of the model without it, fitted likewise, which is no favour to the other.
        held_out: losses on the held-out windows without it and with it, (n,) each.
        sure: standard errors that a sure gain is above zero.
    """
    windows = state.windows
    episodes = windows.held_out.windows.episode
    gain, error = paired_gain(*held_out, episodes, touched=TOUCHED)
    left = float(held_out[0].mean())
    if gain > sure * error or judges_forces(windows.held_out):
        return gain, error
    if left > LEFT_OVER and gain > MOST_OF_THE_REST * (left - 1):
        with_it = loss_by_others(context, state, candidates, x, windows.held_out, windows.fit)
    elif float(np.abs(np.subtract(*held_out)).max()) < NEXT_TO_NOTHING:
        halves = halves_that_show(context, state, effects_of(candidates, x), without, held_out)
        if halves is None:
            return gain, error
        with_it = np.empty(len(windows.fit.windows))
        for half in (halves, ~halves):
            others, own = (windows.fit[np.flatnonzero(rows)] for rows in (~half, half))
            with_it[half] = loss_by_others(context, state, candidates, x, others, own)
    else:
        return gain, error
    before = np.concatenate([held_out[0], context.loss(windows.fit, without)])
    after = np.concatenate([held_out[1], with_it])
    return gain_counted(before, after, np.concatenate([episodes, windows.fit.windows.episode]))


def gain_counted(before: np.ndarray, after: np.ndarray, episodes: np.ndarray) -> tuple[float, float]:
    """As of :func:`~idapt_pl.estimation.intervals.paired_gain`, as sure as if none gained over :data:`MOST_COUNTED`.

    Of three windows that lose all of an error far beyond the noise the largest is no reason to doubt the others.
    """
    gain, error = paired_gain(before, after, episodes, touched=TOUCHED)
    counted = np.clip(before - after, -MOST_COUNTED, MOST_COUNTED)
    mean, spread = paired_gain(counted, np.zeros(len(counted)), episodes, touched=TOUCHED)
    if gain <= 0 or not np.isfinite(error):
        return gain, error
    return gain, gain * spread / mean if mean > 0 else float("inf")


def loss_by_others(
    context: SearchContext,
    state: SearchState,
    candidates: Sequence[Candidate],
    x: Sequence[np.ndarray],
    others: WhitenedWindows,
    own: WhitenedWindows,
) -> np.ndarray:
    """What effects fitted to other windows, from ``x`` on, lose in these, (n,)."""
    fitted = context.fit(others, state.fixed, candidates, x, STEPS_THE_OTHER_WAY).x
    return context.loss(own, (*state.fixed, *effects_of(candidates, fitted)))


def halves_that_show(
    context: SearchContext,
    state: SearchState,
    effects: Effects,
    without: Effects,
    held_out: tuple[np.ndarray, np.ndarray],
) -> np.ndarray | None:
    """Half of the episodes that fits are made on, so that both halves show an effect: their windows, (n,) bool.

    None where fewer than two episodes show it, or held-out ones do.
    """
    split = state.windows.fit
    change = np.abs(context.loss(split, (*state.fixed, *effects)) - context.loss(split, without))
    shown = change > TOUCHED * change.max()
    if np.abs(np.subtract(*held_out)).max() > TOUCHED * change.max():
        return None
    every = split.windows.episode
    showing = np.unique(every[shown])
    if len(showing) < 2:
        return None
    rest = np.setdiff1d(every, showing)
    return np.isin(every, np.concatenate([showing[::2], rest[::2]]))

"""Intervals of what was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import norm

from idapt_pl.diagnosis.candidates.fit import split_parameters
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.estimation.intervals import half_widths, unknown_variance, unseen
from idapt_pl.estimation.least_squares import usual_windows
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.whitening import WhitenedWindows

HALVINGS = 8
"""Of the way to nominal, until the end of an open interval is known to a part in 250."""


def measure_intervals(context: SearchContext, state: SearchState) -> SearchState:
    """Fit once more, without shortcuts, and put 95 % intervals on the estimates.

    Windows that are out of line say nothing: where a contact begins otherwise than it did, slopes are steep and wrong.
    """
    if not state.accepted:
        return state
    windows = windows_in_line(context, state)
    fit = context.fit(windows, state.fixed, state.candidates, state.estimates, 8, exact=True)
    state = state.with_estimates(fit.x)
    by_chance = half_widths(fit.solution, windows.clusters)
    unknown = unknown_variance(fit.solution, systematic_changes(context, state, windows))
    width = np.hypot(by_chance, norm.ppf(0.975) * np.sqrt(unknown))
    width[unseen(fit.solution.J.T @ fit.solution.J)] = np.inf
    halves = split_parameters(state.candidates, width * np.concatenate([c.scale for c in state.candidates]))
    timestep = context.sim.compile(state.fixed).opt.timestep
    pairs = list(enumerate(zip(state.accepted, halves, strict=True)))
    measured = [with_interval(a, half, timestep, worse_from(context, state, k, half)) for k, (a, half) in pairs]
    return replace(state, accepted=tuple(measured))


def worse_from(context: SearchContext, state: SearchState, k: int, half: np.ndarray) -> float | None:
    """Of an effect's only parameter, which may be anything on one side: from where on, towards nominal, it may not.

    As of a stop that a joint goes beyond: its place shows nowhere, but it is not where the model has it.

    Args:
        context: of the search.
        state: its fits.
        k: which of the accepted effects.
        half: half the width of its parameters' intervals, (p,).

    Returns:
        The value nearest to nominal that is not clearly worse; None where nominal itself is none the worse, or where
        the interval is finite anyway.
    """
    a, windows = state.accepted[k], state.windows.fit
    if len(half) > 1 or (np.isfinite(half[0]) and a.candidate.kind is not JointRange):
        return None

    def worse(value: float) -> bool:
        x = [*state.estimates[:k], np.array([value]), *state.estimates[k + 1 :]]
        gain = context.loss(windows, state.with_estimates(x).effects) - at_best
        return float(gain.mean()) > 2 * float(gain.std()) / np.sqrt(len(gain))

    at_best = context.loss(windows, state.effects)
    well, ill = float(a.x[0]), float(a.candidate.nominal[0])
    if a.candidate.kind is JointRange and (well > ill) != (a.candidate.names == ("upper",)):
        return None  # nearer than in the model: it was met
    if not worse(ill) or (np.isfinite(half[0]) and worse(far_end(a, well))):
        return None  # a stop at the furthest that a joint came has a slope on one side
    for _ in range(HALVINGS):
        between = (well + ill) / 2
        well, ill = (well, between) if worse(between) else (between, ill)
    return well


def far_end(a: AcceptedEffect, x: float) -> float:
    """The end of an effect's only parameter that lies beyond ``x``, as seen from nominal."""
    return float(a.candidate.bounds()[int(x > a.candidate.nominal[0])][0])


def windows_in_line(context: SearchContext, state: SearchState) -> WhitenedWindows:
    """The windows fitted to, without those out of line; all of them where forces are judged."""
    windows = state.windows.fit
    if judges_forces(windows):
        return windows
    return windows[np.flatnonzero(usual_windows(context.loss(windows, state.effects)))]


def systematic_changes(context: SearchContext, state: SearchState, windows: WhitenedWindows) -> list[np.ndarray]:
    """What each systematic error of the sensors would change in the residuals of windows, (n, rows) each."""
    effects = state.effects
    now = context.whitened(windows, effects)
    return context.sim.side_by_side.map(
        lambda error: context.whitened(windows, (*effects, error)) - now, state.windows.noise.systematic
    )


def with_interval(a: AcceptedEffect, half: np.ndarray, timestep: float, edge: float | None = None) -> AcceptedEffect:
    """An effect with an interval of half that width (p,), inside its bounds.

    When in a time step a command acts is convention: delays are no surer than half a time step. A strength that no
    recording shows stays as the model has it; a fit leaves it anywhere. Where it may be anything but as the model has
    it, it is the least change that does, at the ``edge`` (:func:`worse_from`).
    """
    if edge is not None:
        return replace(a, x=np.array([edge]), interval=np.sort([[edge, far_end(a, edge)]], 1))
    if a.candidate.kind in (ActuatorDelay, ActuatorLag):
        half = half + 0.5 * timestep
    low, high = a.candidate.bounds()
    unseen_strength = np.isinf(half) & (np.arange(len(half)) < (a.candidate.strength or len(half)))
    x = np.where(unseen_strength, a.candidate.nominal, a.x)
    return replace(a, x=x, interval=np.stack([np.maximum(x - half, low), np.minimum(x + half, high)], 1))

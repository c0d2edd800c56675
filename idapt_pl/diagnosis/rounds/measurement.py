"""Intervals of what was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from idapt_pl.diagnosis.candidates.fit import split_parameters
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.estimation.intervals import covariance, unknown_variance, unseen


def measure_intervals(context: SearchContext, state: SearchState) -> SearchState:
    """Fit once more, without shortcuts, and put 95 % intervals on the estimates."""
    if not state.accepted:
        return state
    windows = state.windows.fit
    fit = context.fit(windows, state.fixed, state.candidates, state.estimates, 8, exact=True)
    state = state.with_estimates(fit.x)
    V, clusters = covariance(fit.solution, windows.clusters), len(np.unique(windows.clusters))
    by_chance = student.ppf(0.975, max(clusters - 1, 2)) * np.sqrt(np.maximum(np.diag(V), 0))
    unknown = unknown_variance(fit.solution, systematic_changes(context, state))
    width = np.hypot(by_chance, norm.ppf(0.975) * np.sqrt(unknown))
    width[unseen(fit.solution.J.T @ fit.solution.J)] = np.inf
    halves = split_parameters(state.candidates, width * np.concatenate([c.scale for c in state.candidates]))
    timestep = context.sim.compile(state.fixed).opt.timestep
    measured = (with_interval(a, half, timestep) for a, half in zip(state.accepted, halves, strict=True))
    return replace(state, accepted=tuple(measured))


def systematic_changes(context: SearchContext, state: SearchState) -> list[np.ndarray]:
    """What each systematic error of the sensors would change in the residuals fitted to, (n, rows) each."""
    windows, effects = state.windows, state.effects
    now = context.whitened(windows.fit, effects)
    return context.sim.side_by_side.map(
        lambda error: context.whitened(windows.fit, (*effects, error)) - now, windows.noise.systematic
    )


def with_interval(a: AcceptedEffect, half: np.ndarray, timestep: float) -> AcceptedEffect:
    """An effect with an interval of half that width (p,), inside its bounds.

    When in a time step a command acts is convention: delays are no surer than half a time step. A strength that no
    recording shows stays as the model has it; a fit leaves it anywhere.
    """
    if a.candidate.kind in (ActuatorDelay, ActuatorLag):
        half = half + 0.5 * timestep
    low, high = a.candidate.bounds()
    unseen_strength = np.isinf(half) & (np.arange(len(half)) < (a.candidate.strength or len(half)))
    x = np.where(unseen_strength, a.candidate.nominal, a.x)
    return replace(a, x=x, interval=np.stack([np.maximum(x - half, low), np.minimum(x + half, high)], 1))

"""Is it how the equations are integrated? Time step and integrator as discrete effects."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.candidates.listing import numerics_candidates
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState, refit_accepted, renew
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import robust_loss
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
SHARE_BY_NUMERICS, OF_THE_REST = 0.02, 0.1
"""Shares of the loss, and of what of it is above the noise, that other numerics must take away."""
NUMERICS_FLOOR = 1.05
"""Loss at which nothing is left for other numerics to gain."""


def retest_numerics(context: SearchContext, state: SearchState) -> SearchState:
    """Try other numerics, with the accepted effects refitted; again after every addition.

    Returns:
        The state with them, whitened again and refitted, or the same where none is clearly better.
    """
    context.progress("numerics", 0.08)
    if not context.settings.numerics or context.numerics_declared or judges_forces(state.windows.fit):
        return state
    best = best_numerics(context, state)
    if best is None:
        return state
    held_out = state.windows.held_out
    now, after = context.loss(held_out, state.effects), context.loss(held_out, best.effects)
    gain, error = paired_gain(now, after, held_out.windows.episode)
    level = float(now.mean())
    sure = gain - context.settings.sureness * error > 0
    if not (sure and gain > max(0.03 * level, OF_THE_REST * max(level - 1.0, 0.0), 0.05)):
        return state
    taken = [e.to_dict()["parameters"] for e in best.fixed if e.name == Numerics.name]
    log.info("numerics: %s leaves %.3g of %.3g", taken or "the model's own", after.mean(), level)
    return refit_accepted(context, renew(context, best))


def best_numerics(context: SearchContext, state: SearchState) -> SearchState | None:
    """The state with the numerics that leave least on the screen's windows; None where none leaves less.

    The model's own are among them once others were taken. Of those that are about as good the finer ones are taken,
    which are tried later.
    """
    others = tuple(e for e in state.fixed if e.name != Numerics.name)
    z = context.whitened(state.windows.screen, state.effects)
    level = float(robust_loss(z).mean())
    if level < NUMERICS_FLOOR:
        return None
    best, best_loss, asked = None, level, max(SHARE_BY_NUMERICS, OF_THE_REST * (1 - 1 / level))
    for fixed in (others, *((*others, effect) for effect in numerics_candidates(context.sim.model))):
        if fixed == state.fixed:
            continue
        moved = context.whitened(state.windows.screen, (*fixed, *effects_of(state.candidates, state.estimates))) - z
        if np.square(moved).sum() < (asked / 2) ** 2 * np.square(z).sum():
            continue  # |z + moved|² < (1 - asked) |z|² takes a larger one
        x = refit_under(context, state, fixed)
        loss = float(context.loss(state.windows.screen, (*fixed, *effects_of(state.candidates, x))).mean())
        if loss < (1 - SHARE_BY_NUMERICS) * level and loss < 1.3 * best_loss:
            best, best_loss = replace(state, fixed=fixed).with_estimates(x), min(loss, best_loss)
    return best


def refit_under(context: SearchContext, state: SearchState, fixed: tuple) -> Sequence[np.ndarray]:
    """Estimates under other numerics: they shift with the integrator, so effects are compared after a refit."""
    if not state.accepted:
        return state.estimates
    return context.fit(state.windows.screen, fixed, state.candidates, state.estimates, 5).x

"""Causes that are not plausible: tried when all others leave much unexplained, and named last."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.acceptance import why_implausible
from idapt_pl.diagnosis.candidate_fit import effects_of
from idapt_pl.diagnosis.context import SearchContext
from idapt_pl.diagnosis.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.diagnosis.trial import RejectionReason, Trial
from idapt_pl.diagnosis.verdict import FLOOR, SLOPED_FLOOR
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)
MOST_TRIED = 3
"""Of the causes that are not plausible, the best of each kind."""
SHARE_OF_THE_REST = 0.5
"""Of what plausible effects leave above the noise, a cause that is not plausible must remove so much."""


def most_promising(trials: Sequence[Trial]) -> list[Trial]:
    """The trials that ended because they were not plausible, one of each effect and target, best first."""
    best: dict[tuple[str, tuple[str, ...]], Trial] = {}
    for t in trials:
        key = (t.candidate.label, t.candidate.names)
        if t.rejection and t.rejection.reason is RejectionReason.IMPLAUSIBLE and t.gain > 0:
            best[key] = max(best.get(key, t), t, key=lambda t: t.gain)
    return sorted(best.values(), key=lambda t: -t.gain)[:MOST_TRIED]


def try_implausible(context: SearchContext, state: SearchState, trials: Sequence[Trial]) -> SearchState | None:
    """The state with a cause that is not plausible, where it explains most of what all others leave; else None."""
    level = float(context.loss(state.windows.held_out, state.effects).mean())
    promising = most_promising(trials)
    if level < (FLOOR if context.sim.velocities else SLOPED_FLOOR) or not promising:
        return None
    context.progress("trying what is not plausible", 0.9)
    found = [fit_without_range(context, state, t, 1 + max((t.round for t in trials), default=0)) for t in promising]
    best, gain, error = max(found, key=lambda f: f[1])
    if gain - context.settings.sureness * error < SHARE_OF_THE_REST * (level - 1.0):
        return None
    log.info("not plausible, but nothing else explains it: %s", best.accepted[-1].candidate.label)
    return refit_accepted(context, renew(context, best))


def fit_without_range(
    context: SearchContext, state: SearchState, t: Trial, round: int
) -> tuple[SearchState, float, float]:
    """The state with a candidate that may take any possible value, and its held-out gain with its error."""
    anything = replace(t.candidate, plausible=None)
    candidates, start = [*state.candidates, anything], [*state.estimates, t.x[-1]]
    x = context.fit(state.windows.fit, state.fixed, candidates, start, 8).x
    held_out = state.windows.held_out
    now = context.loss(held_out, state.effects)
    after = context.loss(held_out, (*state.fixed, *effects_of(candidates, x)))
    gain, error = paired_gain(now, after, held_out.windows.episode)
    why = why_implausible(t.candidate, np.asarray(x[-1]))
    new = AcceptedEffect(round, anything, x[-1], implausible=why)
    return replace(state.with_estimates(x[:-1]), accepted=(*state.with_estimates(x[:-1]).accepted, new)), gain, error

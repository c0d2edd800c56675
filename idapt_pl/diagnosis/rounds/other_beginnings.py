"""Another first effect, where a search with the best one ends with most of the error still there.

The first of several missing effects is chosen in the shadow of the others. Dry friction may stand in for a damping in a
fluid that is too thick, and then neither the fluid nor anything else helps surely.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, Progression, SearchState, refit_accepted, renew
from idapt_pl.estimation.least_squares import typical_loss
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
FEW_FOUND = 2
"""Effects that a search ends with, at most, to begin otherwise."""
POOR_SHARE = 0.2
"""Share of the loss above noise that is then left, at least."""
BETTER_SHARE = 0.75
"""Share of that which another beginning must come to, at most."""
BEGINNINGS = 2
"""Rivals of the first effect that are begun with."""


def begin_otherwise(
    context: SearchContext, progress: Progression, go_on: Callable[[Progression], Progression]
) -> Progression:
    """A search, or the better one of those that begin with the best rivals of its first effect.

    Args:
        context: of the search.
        progress: where it ended, and all that was tried.
        go_on: searches on from a state to the end.
    """
    state, trials = progress
    windows = state.windows.held_out

    def left(found: SearchState) -> float:
        return typical_loss(context.loss(windows, found.effects)) - 1

    poor = state.accepted and left(state) > POOR_SHARE * left(SearchState(state.fixed, (), state.windows))
    if not poor or len(state.accepted) > FEW_FOUND or left(state) < LEFT_OVER - 1 or judges_forces(windows):
        return progress
    first, known, best = state.accepted[0], {c.label for c in state.candidates}, state
    alike = {t.candidate for t in first.equivalent}
    for t in [t for t in first.rivals if t.candidate not in alike and t.candidate.label not in known][:BEGINNINGS]:
        begun = SearchState(state.fixed, (AcceptedEffect(t.round, t.candidate, t.x[-1]),), state.windows)
        other, tried = go_on((refit_accepted(context, renew(context, begun)), trials))
        trials = tried
        if left(other) < BETTER_SHARE * left(best):
            log.info("begun with %s in place of %s: better", t.candidate.label, first.candidate.label)
            best = other
        if left(best) < LEFT_OVER - 1:
            break
    return best, trials

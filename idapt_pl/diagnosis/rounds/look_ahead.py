"""Two effects at once, where much is unexplained and neither surely helps alone.

Each of several missing effects may make the others' absence worse: with the heavier tool but without the softer servo,
an arm is predicted worse in some episodes. A greedy search ends there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.rounds.acceptance import FAR_LOSS
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)
BRANCHES = 2
"""Candidates that a second one is tried with."""

Round = Callable[[SearchContext, SearchState, int], tuple[SearchState | None, list[Trial]]]
"""A round of the search: the state with one effect more, or None, and what was tried."""


def add_two(
    context: SearchContext, state: SearchState, refused: Sequence[Trial], one_round: Round, round: int
) -> tuple[SearchState | None, list[Trial]]:
    """The state with two effects more, of which the first alone was refused.

    Args:
        context: of the search.
        state: in which no candidate was accepted.
        refused: the trials of that round, whose number is ``round - 1``.
        one_round: looks for the second effect.
        round: number of the second effect's round.

    Returns:
        The state (None where no two surely help, or they are too many), not yet refitted, and what was tried for
        the second effect.
    """
    now = context.loss(state.windows.held_out, state.effects)
    if float(now.mean()) < FAR_LOSS or len(state.accepted) + 2 > context.settings.max_effects:
        return None, []
    for first in first_ones(context, state, refused):
        began = state.with_estimates(first.x[:-1])
        effect = AcceptedEffect(first.round, first.candidate, first.x[-1])
        tentative = refit_accepted(context, renew(context, replace(began, accepted=(*began.accepted, effect))))
        found, tried = one_round(context, tentative, round)
        if found is None:
            continue
        after = context.loss(state.windows.held_out, found.effects)
        gain, error = paired_gain(now, after, state.windows.held_out.windows.episode)
        if gain > context.settings.sureness * error and gain > context.settings.relative_gain * float(now.mean()):
            log.info("two at once: %s with %s", first.candidate.label, found.accepted[-1].candidate.label)
            return found, tried
    return None, []


def first_ones(context: SearchContext, state: SearchState, refused: Sequence[Trial]) -> list[Trial]:
    """Candidates that clearly help where they are fitted, and not surely elsewhere: the best of two different kinds."""
    fitted = float(context.loss(state.windows.scout, state.effects).mean())
    unsure = [t for t in refused if t.rejection is not None and t.rejection.reason is RejectionReason.UNSURE_GAIN]
    best: dict[str, Trial] = {}
    for t in sorted(unsure, key=lambda t: t.rough_loss):
        if t.rough_loss < 0.9 * fitted:
            best.setdefault(t.candidate.kind.name, t)
    return list(best.values())[:BRANCHES]

"""Causes that are not plausible: tried when all others leave much unexplained, and named last."""

from __future__ import annotations

import logging
from dataclasses import replace

from idapt_pl.diagnosis.answer.verdict import FLOOR, SLOPED_FLOOR
from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.rounds.acceptance import confirm
from idapt_pl.diagnosis.rounds.gates import why_implausible
from idapt_pl.diagnosis.rounds.screening import screen_candidates, shortlist
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.effects.candidate import Candidate
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
SHARE_OF_THE_REST = 0.5
"""Of what plausible effects leave above the noise, a cause that is not plausible must remove so much."""


def try_implausible(
    context: SearchContext, state: SearchState, round: int
) -> tuple[SearchState | None, tuple[Trial, ...]]:
    """Look once more, at whatever can be simulated.

    Args:
        context: of the search.
        state: what plausible effects come to.
        round: of what is tried.

    Returns:
        The state with a cause that is not plausible, where it explains most of what all others leave, else None; and
        what was tried that is not plausible.
    """
    narrow = {(c.label, c.names): c for c in context.candidates}
    anything = [c for c in context.unlimited if (n := narrow.get((c.label, c.names))) and is_narrower(n)]
    level = float(context.loss(state.windows.held_out, state.effects).mean())
    floor = FLOOR if context.sim.velocities else SLOPED_FLOOR
    if level < floor or not anything or judges_forces(state.windows.held_out):
        return None, ()
    context.progress("trying what is not plausible", 0.89)
    context = replace(context, candidates=anything)
    chosen = shortlist(screen_candidates(context, state, round), context.settings.confirm)
    tried = []
    for t in confirm(context, state, chosen):
        why = why_implausible(narrow[t.candidate.label, t.candidate.names], t.x[-1])
        if why and t.rejection is None:
            tried.append(t.rejected(RejectionReason.IMPLAUSIBLE, why))
    best = max(tried, key=lambda t: t.gain, default=None)
    if best is None or best.gain < SHARE_OF_THE_REST * (level - 1.0):
        return None, tuple(tried)
    log.info("not plausible, but nothing else explains it: %s", best.candidate.label)
    assert best.rejection is not None, "it was said why"
    new = AcceptedEffect(round, best.candidate, best.x[-1], implausible=best.rejection.text)
    before = state.with_estimates(best.x[:-1])
    found = replace(before, accepted=(*before.accepted, new))
    others = tuple(t for t in tried if t is not best)
    return refit_accepted(context, renew(context, found)), (*others, replace(best, rejection=None))


def is_narrower(c: Candidate) -> bool:
    """Whether a simulation could take more than what is plausible."""
    (low, high), (least, most) = c.bounds(), c.possible()
    return bool((low > least).any() or (high < most).any())

"""Earlier choices made otherwise, one at a time, where a search ends close to the noise, yet not at it.

A greedy search takes effect after effect. Two of them may be wrong together: a servo's offset and an encoder's, each at
the joint of the other. No rival of one alone helps then, but what the search would have come to from there does. Such
searches, which differ in one choice, are made in the order in which the choices were close (limited discrepancy search,
Harvey & Ginsberg 1995).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds.acceptance import FAR_LOSS
from idapt_pl.diagnosis.rounds.gates import SURELY_BETTER
from idapt_pl.diagnosis.rounds.other_beginnings import BETTER_SHARE
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, Progression, SearchState, refit_accepted, renew
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import typical_loss
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
ABOVE_NOISE = 1.2
"""Typical held-out loss (1 is noise) above which choices are made otherwise."""
MOST_CHOICES = 2
"""Choices that are made otherwise."""
CLOSE = 1.5
"""Times what the effect chosen left after a rough fit that a rival of its round may have left."""


def choose_otherwise(
    context: SearchContext, progress: Progression, go_on: Callable[[Progression], Progression]
) -> Progression:
    """A search, or the best one of those that make one of its closest choices otherwise.

    Args:
        context: of the search.
        progress: where it ended, and all that was tried.
        go_on: searches on from a state to the end.
    """
    best, trials = progress
    windows = best.windows.held_out
    loss = context.loss(windows, best.effects)
    if len(best.accepted) < 2 or judges_forces(windows) or not ABOVE_NOISE < typical_loss(loss) < FAR_LOSS:
        return progress
    for t in close_choices(*progress)[:MOST_CHOICES]:
        other, trials = go_on((chosen_instead(context, progress[0], t), trials))
        after = context.loss(windows, other.effects)
        gain, error = paired_gain(loss, after, windows.windows.episode)
        if gain > SURELY_BETTER * error and float(after.mean()) - 1 < BETTER_SHARE * (float(loss.mean()) - 1):
            log.info("with %s chosen in round %d it is better", t.candidate.label, t.round)
            best, loss = other, after
        if typical_loss(loss) < ABOVE_NOISE:
            break
    return best, trials


def close_choices(state: SearchState, trials: Sequence[Trial]) -> list[Trial]:
    """Rivals of what was found, of its rounds, the closest first; they are no part of it."""
    found, close = {c.label for c in state.candidates}, []
    for a in state.accepted:
        fitted = [t for t in trials if t.round == a.round and t.rough_loss > 0]
        chosen = min((t.rough_loss for t in fitted if not t.rejection), default=0.0)
        rivals = {t.candidate.label: t for t in fitted if t.candidate.label not in found and t.x}
        close += [(t.rough_loss / chosen, t) for t in rivals.values() if t.rough_loss < CLOSE * chosen]
    return [t for _, t in sorted(close, key=lambda pair: pair[0])]


def chosen_instead(context: SearchContext, state: SearchState, t: Trial) -> SearchState:
    """What was found before a round, with a rival in place of what was chosen there, fitted."""
    before = tuple(a for a in state.accepted if a.round < t.round)
    begun = SearchState(state.fixed, (*before, AcceptedEffect(t.round, t.candidate, t.x[-1])), state.windows)
    return refit_accepted(context, renew(context, begun))

"""What does as well as an effect found, judged again where a search ends: beside all the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds.acceptance import no_clear_difference
from idapt_pl.diagnosis.rounds.revision import with_rival
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState

NEARLY_AS_GOOD = 0.9
"""Share of an effect's gain that a rival had beside it: found before others were known, it may be as good by now."""


def with_equivalents_of_now(context: SearchContext, state: SearchState) -> SearchState:
    """The state with the equivalents of each effect fitted again; those that are clearly worse now are mere rivals.

    So are rivals of as many parameters that were nearly as good, where others were found since.
    """
    if not any(a.equivalent or may_do_as_well(a, state) for a in state.accepted):
        return state
    losses = context.loss(state.windows.held_out, state.effects)
    return replace(state, accepted=tuple(judged_again(context, state, a, losses) for a in state.accepted))


def judged_again(context: SearchContext, state: SearchState, effect: AcceptedEffect, now: np.ndarray) -> AcceptedEffect:
    """An effect with the equivalents that still are; ``now``: held-out losses of what was found, (n,)."""
    fitted = [fitted_instead(context, state, effect, t) for t in may_do_as_well(effect, state)]
    episodes = state.windows.held_out.windows.episode
    equal = tuple(t for t in fitted if not (clearly_worse(t, now, episodes) or worse_in_all(context, state, effect, t)))
    behind = tuple(t for t in fitted if t not in equal)
    rivals = (t for t in effect.rivals if not any(is_same(t, f) for f in fitted))
    return replace(effect, equivalent=equal, rivals=(*behind, *rivals))


def may_do_as_well(effect: AcceptedEffect, state: SearchState) -> list[Trial]:
    """Trials that an effect's place is tried with."""
    near = [
        t for t in effect.rivals
        if len(state.accepted) > 1 and t.candidate.size == effect.candidate.size
        and t.gain >= NEARLY_AS_GOOD * effect.gain and not any(is_same(t, e) for e in effect.equivalent)
    ]  # fmt: skip
    return [t for t in (*effect.equivalent, *near) if not is_accepted(t, state)]


def clearly_worse(t: Trial, now: np.ndarray, episodes: np.ndarray) -> bool:
    """Whether a trial leaves clearly more than what was found; ``now``: losses of that, (n,), in windows of these."""
    assert t.losses is not None, "what was fitted was judged"
    return t.held_out > now.mean() and not no_clear_difference(now, t.losses, episodes)


def worse_in_all(context: SearchContext, state: SearchState, effect: AcceptedEffect, trial: Trial) -> bool:
    """Whether a trial leaves clearly more in all windows, those that it is fitted to among them.

    What a fit explains of the noise is the same for as many parameters, so none is judged by another number of them.
    """
    if trial.candidate.size != effect.candidate.size:
        return False
    windows, instead = state.windows, with_rival(state, effect, trial.candidate, trial.x)
    fitted = instead.with_estimates(context.fit(windows.fit, state.fixed, instead.candidates, instead.estimates, 2).x)
    parts = (windows.fit, windows.held_out)
    now, other = (np.concatenate([context.loss(w, s.effects) for w in parts]) for s in (state, fitted))
    episodes = np.concatenate([w.windows.episode for w in parts])
    return other.mean() > now.mean() and not no_clear_difference(now, other, episodes)


def fitted_instead(context: SearchContext, state: SearchState, effect: AcceptedEffect, trial: Trial) -> Trial:
    """A trial's candidate in the place of an effect, all parameters fitted again: the others' first, then its own."""
    instead = with_rival(state, effect, trial.candidate, (*state.without(effect).estimates, trial.x[-1]))
    candidates = instead.candidates
    fitted = context.fit(state.windows.screen, state.fixed, candidates, instead.estimates, 3).x
    losses = context.loss(state.windows.held_out, (*state.fixed, *effects_of(candidates, fitted)))
    place = state.accepted.index(effect)
    return replace(trial, x=(*fitted[:place], *fitted[place + 1 :], fitted[place]), losses=losses)


def is_accepted(t: Trial, state: SearchState) -> bool:
    """Whether a trial is of a candidate that was accepted by now."""
    return any((t.candidate.label, t.candidate.names) == (c.label, c.names) for c in state.candidates)


def is_same(one: Trial, other: Trial) -> bool:
    """Whether two trials are of the same candidate."""
    return (one.candidate.label, one.candidate.names) == (other.candidate.label, other.candidate.names)

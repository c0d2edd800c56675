"""Reopen early choices: swap an effect for a rival of its round, leave out what has become needless."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds.acceptance import FAR_LOSS, PARSIMONY, rough_fits
from idapt_pl.diagnosis.rounds.both_ways import gain_on_all
from idapt_pl.diagnosis.rounds.gates import (
    AT_THE_FLOOR,
    CLEAR_GAIN,
    SURELY_BETTER,
    Judged,
    beyond_its_kind,
    earns_its_place,
    why_implausible,
)
from idapt_pl.diagnosis.rounds.measurement import measure_intervals
from idapt_pl.diagnosis.rounds.numerics import retest_numerics
from idapt_pl.diagnosis.rounds.replay import worse_replays
from idapt_pl.diagnosis.rounds.screening import screen_candidates, shortlist
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import (
    AcceptedEffect,
    SearchState,
    refit_accepted,
    refit_without,
    renew,
    slopes_of_accepted,
)
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.plausible import rarity
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.stepwise import backward_elimination
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
SWAP_PASSES = 2
"""How often all found effects are gone through, while much is unexplained and rivals go on taking places."""
PLACES_SCREENED = 4
"""So many of the first effects stand against all others while much is unexplained: each takes a round's time."""
FAR_WORSE = 1.5
"""Times the fitted loss with an effect that is surely left without it: it is not needless."""
AS_GOOD_AS = 1.1
"""Times the same that a rival in its place must be able to come to."""
IN_SIGHT = 1.5
"""Of the loss with an effect, what a rival may leave after a rough fit, to be fitted properly in its place."""
MANY_PARAMETERS = 3
"""An effect with so many bends to what others did: beside others it has to stand against all of them."""


def swap_for_rivals(context: SearchContext, state: SearchState) -> SearchState:
    """Was an early choice wrong, made before later effects and the numerics were known? Try its rivals again.

    Where several effects are missing at once and much of the error stays, the first choice was made in their shadow,
    and so were its rivals: then every effect has to stand against whatever the screen finds best in its place. So has
    one of many parameters beside others, and there a simpler one that is as good takes its place.
    """
    context.progress("trying rivals", 0.88)
    last = len(state.accepted)  # place in which a rival came last: those after it stood beside it already
    for _ in range(SWAP_PASSES):
        far = len(state.accepted) > 1 and far_from_explained(context, state)
        places = len(state.accepted) if far or len(state.accepted) < 2 else len(state.accepted) - 1
        before = state
        for place in range(min(places, last + 1)):
            bends = len(state.accepted) > 1 and state.accepted[place].candidate.size >= MANY_PARAMETERS
            afresh = bends or (far and place < PLACES_SCREENED)
            rivals = rivals_for(context, state, place) if afresh else state.accepted[place].rivals
            other = swap_one(context, state, place, rivals)
            state, last = other, last if other is state else place
        if not far or state is before:
            break
    return state


def far_from_explained(context: SearchContext, state: SearchState) -> bool:
    """Whether so much of the held-out error is left that more than one effect must be missing or wrong."""
    return level(context, state) > FAR_LOSS


def level(context: SearchContext, state: SearchState) -> float:
    """Mean held-out loss."""
    return float(context.loss(state.windows.held_out, state.effects).mean())


def rivals_for(context: SearchContext, state: SearchState, place: int) -> list[Trial]:
    """The best candidates for the place of a found effect, given the others; roughly refitted."""
    own = state.accepted[place].candidate
    rest = refit_accepted(context, state.without(state.accepted[place]))
    ranked = screen_candidates(context, rest, len(state.accepted), as_seen_before=True)
    others = [t for t in ranked if (t.candidate.label, t.candidate.names) != (own.label, own.names)]
    most = IN_SIGHT * float(context.loss(state.windows.scout, state.effects).mean())
    rough = rough_fits(context, rest, shortlist(others, context.settings.confirm), most)
    return [t for t in rough if t.rough_loss < most][:3]


def swap_one(context: SearchContext, state: SearchState, place: int, rivals: Sequence[Trial]) -> SearchState:
    """The state with a rival in the place of an effect, or the same where none is clearly better.

    One of more parameters must surely be better.
    """
    old, known = state.accepted[place], {(c.label, c.names) for c in state.candidates}
    rivals = [t for t in rivals if (t.candidate.label, t.candidate.names) not in known]
    now = context.loss(state.windows.held_out, state.effects)
    best: Candidate | None = None
    best_x: tuple[np.ndarray, ...] = ()
    best_loss = float(now.mean())
    simpler_ones = [t for t in rivals if old.candidate.size - t.candidate.size >= 2]  # as good is good enough
    worth_fitting = rivals if best_loss > AT_THE_FLOOR else simpler_ones
    slopes = slopes_of_accepted(context, state.without(old), state.windows.fit) if worth_fitting else None
    fits = context.sim.side_by_side.map(lambda t: fit_in_place(context, state, old, t, slopes), worth_fitting)
    for t, x in zip(worth_fitting, fits, strict=True):
        simpler = t in simpler_ones
        if x is None or beyond_its_kind(t.candidate, x[-1]) or why_implausible(t.candidate, x[-1]):
            continue
        candidates = [*state.without(old).candidates, t.candidate]
        after = context.loss(state.windows.held_out, (*state.fixed, *effects_of(candidates, x)))
        gain, error = paired_gain(now, after, state.windows.held_out.windows.episode)
        dearer = PARSIMONY * max(t.candidate.size - old.candidate.size, 0) * max(gain, 0.0)
        loss = float(after.mean()) + rarity(t.candidate) * max(gain, 0.0) + dearer
        unsure = error * (SURELY_BETTER if t.candidate.size > old.candidate.size else 1.0)
        asked = -0.02 * float(now.mean()) if simpler else max(unsure, 0.03 * float(now.mean()))
        if gain > asked and loss < (best_loss if best is not None or not simpler else np.inf):
            best, best_loss, best_x = t.candidate, loss, x
    if best is None:
        return state
    log.info("%s in place of %s: %.3g", best.label, old.candidate.label, best_loss)
    state = with_rival(state, old, best, best_x)
    return retest_numerics(context, refit_accepted(context, renew(context, state)))


def fit_in_place(
    context: SearchContext, state: SearchState, old: AcceptedEffect, t: Trial, slopes: np.ndarray | None
) -> tuple[np.ndarray, ...] | None:
    """Fit a rival in the place of an effect, all others free; None where it would leave more than that does.

    ``slopes`` are by the others' parameters, (n rows, q).

    Returns:
        Parameters of the others in their order, then its own.
    """
    rest, split = state.without(old), state.windows.fit
    start, most = [*rest.estimates, t.x[-1]], AS_GOOD_AS * fitted_loss(context, state)
    candidates = [*rest.candidates, t.candidate]
    fit = context.fit(split, state.fixed, candidates, start, 5, slopes=slopes, good_enough=most)
    return None if fit.solution.given_up else fit.x


def with_rival(state: SearchState, old: AcceptedEffect, new: Candidate, x: Sequence[np.ndarray]) -> SearchState:
    """A candidate in the place of an effect; ``x``: parameters of the others in their order, then its own."""
    others = iter(x[:-1])
    taken = replace(old, candidate=new, x=x[-1], equivalent=())
    return replace(state, accepted=tuple(taken if a is old else replace(a, x=next(others)) for a in state.accepted))


def eliminate_needless(context: SearchContext, state: SearchState) -> SearchState:
    """Leave out again what the later effects have made needless."""
    context.progress("pruning", 0.9)

    def without(state: SearchState, round: int) -> SearchState | None:
        return without_if_needless(context, state, next(a for a in state.accepted if a.round == round))

    return backward_elimination(state, [a.round for a in state.accepted], without)


def without_if_needless(context: SearchContext, state: SearchState, effect: AcceptedEffect) -> SearchState | None:
    """The state without an effect, the others refitted, where they do as well alone."""
    enough = FAR_WORSE * fitted_loss(context, state)
    rest, left = refit_without(context, state, effect, enough)
    if left and does_without(context, state, rest, effect):  # the fit was left too early to tell
        rest, left = refit_accepted(context, rest), False
    if left or not does_without(context, state, rest, effect):
        return None
    log.info(
        "pruned %s: %.3g with it, %.3g without", effect.candidate.label, level(context, state), level(context, rest)
    )
    return rest


def fitted_loss(context: SearchContext, state: SearchState) -> float:
    """Mean loss on the windows that effects are fitted to."""
    return float(context.loss(state.windows.fit, state.effects).mean())


def does_without(context: SearchContext, state: SearchState, rest: SearchState, effect: AcceptedEffect) -> bool:
    """Whether a model does as well without one of its effects, the others refitted (``rest``)."""
    settings, held_out = context.settings, state.windows.held_out
    with_it, without = context.loss(held_out, state.effects), context.loss(held_out, rest.effects)
    gain, error = gain_on_all(
        context, state, state.candidates, state.estimates, rest.effects, (without, with_it), sure=settings.sureness
    )
    by_forces = judges_forces(held_out)
    if by_forces:  # few instants tell of forces, replays nothing, and all joints have friction
        settings = replace(settings, sureness=0.0, relative_gain=settings.relative_gain / context.sim.model.nv)
    further = effect is not state.accepted[0]
    judged = Judged(effect.candidate, effect.x, gain, error, float(without.mean()), further, settings)
    if not earns_its_place(judged):
        return True
    doubtful = settings.plausible and not by_forces and gain < CLEAR_GAIN * judged.level
    return doubtful and worse_replays(context, state, rest)


def one_gain_for_many(context: SearchContext, state: SearchState) -> SearchState:
    """The state with a gain of all motors, where that makes others needless and fewer parameters do as well.

    A weaker motor looks like heavier bodies, more damping and more friction, all by one factor.
    """
    known = {a.candidate.label for a in state.accepted}
    gains = [c for c in context.candidates if c.kind is ActuatorGain and c.label not in known]
    gain = next((c for c in gains if c.target == "*" or context.sim.model.nu == 1), None)
    if len(state.accepted) < 3 or gain is None or judges_forces(state.windows.fit):
        return state
    round = 1 + max(a.round for a in state.accepted)
    wider = replace(state, accepted=(*state.accepted, AcceptedEffect(round, gain, np.array(gain.nominal, float))))
    other = eliminate_needless(context, refit_accepted(context, wider))
    fewer = sum(c.size for c in other.candidates) < sum(c.size for c in state.candidates)
    before, after = level(context, state), level(context, other)
    if not fewer or after > 1.02 * before:
        return state
    log.info("%s in place of several: %.3g, %.3g before", gain.label, after, before)
    return retest_numerics(context, refit_accepted(context, renew(context, other)))


def keep_sure(context: SearchContext, state: SearchState) -> SearchState:
    """Put intervals on the estimates, and leave out, one by one, what may as well be as the model has it.

    What ended where no machine is says so.
    """
    context.progress("measuring", 0.92)
    state = measure_intervals(context, state)
    while context.settings.plausible and (unsure := [a for a in state.accepted if a.unsure]):
        least = min(unsure, key=lambda a: a.candidate.change(a.x))
        log.info("left out %s: its interval holds what the model has", least.candidate.label)
        rest = refit_accepted(context, renew(context, state.without(least)))
        state = measure_intervals(context, retest_numerics(context, rest))
    return replace(state, accepted=tuple(map(with_its_doubts, state.accepted)))


def with_its_doubts(a: AcceptedEffect) -> AcceptedEffect:
    """An effect that the last fits drove to the end of what is plausible, with the reason why it is named last."""
    return replace(a, implausible=a.implausible or why_implausible(a.candidate, a.x))

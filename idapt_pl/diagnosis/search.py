"""The search: numerics, then round by round screen, confirm, accept; at the end revise and measure."""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco

from datamodules import Trajectories
from idapt_pl.diagnosis.answer.changes import changes_over_recordings, find_changes
from idapt_pl.diagnosis.answer.detection_limits import detection_limits
from idapt_pl.diagnosis.answer.laws import add_laws
from idapt_pl.diagnosis.answer.result import DiagnosisResult, Verdict
from idapt_pl.diagnosis.answer.summary import summarise_search
from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.last_resort import try_implausible
from idapt_pl.diagnosis.laws.library_words import explained_by_library
from idapt_pl.diagnosis.laws.search import search_laws
from idapt_pl.diagnosis.prepare import begin_search
from idapt_pl.diagnosis.rounds.acceptance import accept, confirm
from idapt_pl.diagnosis.rounds.all_at_once import add_all_at_once
from idapt_pl.diagnosis.rounds.discrepancies import choose_otherwise
from idapt_pl.diagnosis.rounds.look_ahead import add_two
from idapt_pl.diagnosis.rounds.numerics import retest_numerics
from idapt_pl.diagnosis.rounds.other_beginnings import begin_otherwise
from idapt_pl.diagnosis.rounds.replay import at_rest
from idapt_pl.diagnosis.rounds.revision import (
    eliminate_needless,
    far_from_explained,
    keep_sure,
    level,
    one_gain_for_many,
    swap_for_rivals,
)
from idapt_pl.diagnosis.rounds.screening import screen_candidates, shortlist
from idapt_pl.diagnosis.rounds.stops_besides import add_stops
from idapt_pl.diagnosis.rounds.taking_apart import many_for_one_gain, own_for_shared_motor, single_for_shared
from idapt_pl.diagnosis.rounds.unexplained_forces import HOPELESS, beyond_noise, contradicts_forces, judge_by_noise
from idapt_pl.diagnosis.rounds.usual_causes import begin_with_usual_causes
from idapt_pl.diagnosis.state.context import Progress, SearchContext
from idapt_pl.diagnosis.state.search_state import Progression, SearchState, refit_accepted, renew
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS, NOT_TRIED_QUICKLY, SearchSettings
from idapt_pl.effects.base import Effect
from idapt_pl.estimation.stepwise import forward_selection
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects, Simulator

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The outcome, and what it was made with.

    Attributes:
        result: what was found.
        effects: of the repaired model: declared ones, numerics and those found.
        declared: effects known beforehand.
        sim: of the nominal model, with the recordings.
        held_out: windows that it was judged on.
        trials: everything tried, round by round.
        context: what stayed the same throughout the search.
        state: where the search ended.
    """

    result: DiagnosisResult
    effects: Effects
    declared: Effects
    sim: Simulator
    held_out: Windows
    trials: tuple[Trial, ...]
    context: SearchContext
    state: SearchState

    @property
    def verdict(self) -> Verdict:
        """One of the four verdicts."""
        return self.result.verdict

    @property
    def by_forces(self) -> bool:
        """Whether models were judged by forces, not by forecasts."""
        return judges_forces(self.state.windows.fit)

    @property
    def report(self) -> dict:
        """The content of ``report.json``."""
        return self.result.to_dict()


def diagnose(
    model: mujoco.MjSpec,
    trajectories: Trajectories,
    declared: Sequence[Effect] = (),
    fit: Sequence[int] | None = None,
    hold_out: Sequence[int] | None = None,
    candidates: Sequence[str] | None = None,
    seed: int = 0,
    settings: SearchSettings = DEFAULT_SETTINGS,
    progress: Progress = lambda what, done: None,
    threads: int | None = None,
    unmeasured: Sequence[str] = (),
    noise: Noise | None = None,
    laws: bool = True,
) -> Diagnosis:
    """Which physical effects does the model lack, by the recordings?

    Args:
        model: the nominal model.
        trajectories: measured episodes with ``qpos`` (and ``qvel``) and actions.
        declared: effects known already, applied throughout.
        fit: episodes to fit on; default three quarters, spread evenly.
        hold_out: episodes to judge on; default the others.
        candidates: names of the effects to consider; default all.
        seed: of the choice of windows.
        settings: how hard to look.
        progress: told what is being done.
        threads: for simulating; default all cores.
        unmeasured: joints whose positions in the recordings are made up: nothing is judged by them. The model's motion
            must not depend on where they are, only on how fast they move. Or ``"<joint> velocity"``, with which
            windows only begin.
        noise: of the sensors, where it is known; default is to estimate it from the recordings.
        laws: where much stays unexplained, look for a law of force (:mod:`~idapt_pl.diagnosis.laws.search`).

    Raises:
        UnusableData: the recordings do not fit the model.
        ValueError: an unknown candidate or episode.
    """
    started = time.perf_counter()
    context, state = begin_search(
        model, trajectories, declared, fit, hold_out, candidates, seed, settings, progress, threads, unmeasured, noise
    )
    found = judge(context, run_search(context, state))
    if laws:
        found = with_laws(found)
    progress("done", 1.0)
    return replace(found, result=replace(found.result, runtime_s=round(time.perf_counter() - started, 2)))


def judge(context: SearchContext, progress: Progression) -> Diagnosis:
    """What a search came to: do effects change, and how good is the repaired model?"""
    state, trials = progress
    context.progress("judging", 0.95)
    if context.settings.thorough and judges_forces(state.windows.fit):
        result = summarise_search(context, state, trials)
    elif context.settings.thorough:
        changes, state = find_changes(context, state)
        told = summarise_search(context, state, trials)
        quiet = told.verdict is Verdict.INSUFFICIENT_EXCITATION  # what hardly moves answers to the noise of its starts
        result = replace(told, changes=changes, limits=() if quiet else detection_limits(context, state))
    else:
        result = replace(summarise_search(context, state, trials), not_tried=NOT_TRIED_QUICKLY)
    held_out = state.windows.held_out.windows
    return Diagnosis(result, state.effects, context.declared, context.sim, held_out, trials, context, state)


def with_laws(found: Diagnosis, again: bool = False) -> Diagnosis:
    """A diagnosis with laws of force, where much stays unexplained that no change over the recordings explains.

    Where the first law is made of effects of the library, the search goes on with these (once) before there are laws.
    """
    context, started = found.context, time.perf_counter()
    ended = changes_over_recordings(found.result.changes) or judges_forces(found.state.windows.fit)
    search = None if ended else search_laws(context, found.state)
    if search is None:
        return found
    other = explained_by_library(context, found.state, search.hint) if search.hint and not again else None
    if other is not None:
        state, trials = select_and_revise(context, (other, found.trials))
        judged = judge(context, (settle(context, state), trials))
        kept = replace(judged.result, splits=found.result.splits, runtime_s=found.result.runtime_s)
        return with_laws(replace(judged, result=kept), again=True)
    seconds, known = time.perf_counter() - started, found.result
    state, result = add_laws(context, search, found.trials, known, seconds)
    result = replace(result, changes=known.changes, splits=known.splits, limits=known.limits, runtime_s=known.runtime_s)
    held_out = state.windows.held_out.windows
    return replace(found, result=result, effects=state.effects, held_out=held_out, state=state)


FIRST_EFFECTS = 3
"""After so many a search looks whether it gets anywhere."""

REVISIONS = 3
"""How often effects are added again, where reopened choices changed what was found."""


def run_search(context: SearchContext, state: SearchState) -> Progression:
    """Greedy forward search with pruning; every acceptance is decided on episodes nothing was fitted to."""
    if at_rest(context, state):
        return state, tuple(map(without_motion, screen_candidates(context, state, 0)))
    if not context.settings.thorough:
        begun = add_effects(context, (retest_numerics(context, state), ()))
        state, trials = by_forces_if_need_be(
            context, begun, lambda p: p if context.hurried else add_effects(context, p, to_the_end=True)
        )
        return keep_sure(context, eliminate_needless(context, state)), trials
    begun = select_and_revise(context, (retest_numerics(context, state), ()))
    to_the_end = functools.partial(select_and_revise, context, to_the_end=True)
    by_forecasts = with_stops(context, by_forces_if_need_be(context, begun, to_the_end), to_the_end)
    begun = begin_otherwise(context, by_forecasts, to_the_end)
    state, trials = choose_otherwise(context, begun, to_the_end)
    other, tried = try_implausible(context, state, next_round(trials, state))
    trials = (*trials, *tried)
    if other is not None:  # what was found in its shadow may be needless now, and more may show
        state = eliminate_needless(context, retest_numerics(context, other))
        state, trials = select_and_revise(context, (state, trials))
    return settle(context, state), trials


def with_stops(
    context: SearchContext, progress: Progression, go_on: Callable[[Progression], Progression]
) -> Progression:
    """A search, with the end stops that show beside what it found; where there are any it goes on."""
    state, trials = progress
    found, tried = add_stops(context, progress, one_round, next_round(trials, state))
    return (state, tried) if found is state else go_on((found, tried))


def settle(context: SearchContext, state: SearchState) -> SearchState:
    """The end of a search: fewer effects where they do as well, and those that are sure."""
    fewest = many_for_one_gain(context, one_gain_for_many(context, state))
    return keep_sure(context, single_for_shared(context, own_for_shared_motor(context, fewest)))


def select_and_revise(
    context: SearchContext, progress: Progression, most: int | None = None, to_the_end: bool = False
) -> Progression:
    """Add effects until none helps (``most`` each time), then reopen earlier choices; where one changed, add again.

    With ``most`` the effects that it begins with do not count among those at which a search stops.
    What was hidden behind a wrong first choice shows once that is put right. The search breaks off where it leads
    nowhere (:func:`leads_nowhere`); ``to_the_end`` not even if forces contradict it.
    """
    all_together = len(progress[0].accepted) + context.settings.max_effects
    for revision in range(REVISIONS):
        before = level(context, progress[0])
        if most is None:
            progress = add_effects(context, progress, to_the_end)
        else:
            progress = add_one_by_one(context, progress, min(most, all_together - len(progress[0].accepted)))
        state, trials = progress
        if not state.accepted or context.hurried or leads_nowhere(context, state, to_the_end):
            break
        if revision and far_from_explained(context, state) and level(context, state) > 0.9 * before:
            return eliminate_needless(context, state), trials  # little came, and reopening what is far takes long
        revised = eliminate_needless(context, swap_for_rivals(context, state))
        progress = revised, trials
        if labels(revised) == labels(state):
            break
    return progress


def add_effects(context: SearchContext, progress: Progression, to_the_end: bool = False) -> Progression:
    """Add effects one by one, unless the first of them show that this leads nowhere.

    Where they stay far from the recordings, the usual ones of all joints and motors are tried at once.
    """
    most = context.settings.max_effects
    state, trials = add_one_by_one(context, progress, min(most - len(progress[0].accepted), FIRST_EFFECTS))
    taken = len(state.accepted) - len(progress[0].accepted)
    far = taken and context.settings.thorough and far_from_explained(context, state)
    if (taken < FIRST_EFFECTS and not far) or leads_nowhere(context, state, to_the_end):
        return state, trials
    wider = add_all_at_once(context, state, next_round(trials, state)) if far else state
    if taken < FIRST_EFFECTS and wider is state:
        return state, trials
    return add_one_by_one(context, (wider, trials), most - len(wider.accepted))


def leads_nowhere(context: SearchContext, state: SearchState, to_the_end: bool = False) -> bool:
    """Whether a search by forecasts had better begin anew, judged by forces."""
    return beyond_noise(context, state, HOPELESS) or (not to_the_end and contradicts_forces(context, state))


def by_forces_if_need_be(
    context: SearchContext, progress: Progression, go_on: Callable[[Progression], Progression]
) -> Progression:
    """A search that begins anew, judged by forces, where noise is no yardstick or forces contradict what was found.

    Where these come to little either, the search by forecasts goes on: the wrong first choice may still be revised. So
    it does where what they explain forecasts worse than the model as it was: friction that is taken for weight does.
    """
    if contradicts_forces(context, progress[0]):
        log.info("what was found leaves more force unexplained than the model as it was: forces judge")
        anew = search_by_forces(context, progress)
        if explains_forces(context, anew[0]) and not forecasts_worse(context, progress[0], anew[0]):
            return anew
        progress = go_on(progress)
    if not beyond_noise(context, progress[0]):
        return progress
    state, trials = search_by_forces(context, progress)
    if forecasts_worse(context, progress[0], state):
        return progress
    return judge_by_noise(context, state), trials


def forecasts_worse(context: SearchContext, yardstick: SearchState, found: SearchState) -> bool:
    """Whether what was found by forces forecasts worse than the model as it was given.

    Args:
        context: of the search.
        yardstick: its windows are judged by forecasts.
        found: judged by forces.
    """
    by_forecasts = level(context, replace(yardstick, accepted=found.accepted))
    if worse := by_forecasts > level(context, replace(yardstick, accepted=())):
        log.info("what forces explain forecasts worse than the model as it was: forecasts judge")
    return worse


def explains_forces(context: SearchContext, state: SearchState) -> bool:
    """Whether half of the unexplained force (squared) is explained."""
    before = level(context, replace(state, accepted=()))
    return judges_forces(state.windows.fit) and level(context, state) < 0.5 * before


def search_by_forces(context: SearchContext, progress: Progression) -> Progression:
    """A search that begins anew with what every joint has, judged by forces; the same where it comes to no better.

    A quick look has no time for more than that.
    """
    old = progress[0]
    begun = begin_with_usual_causes(context, replace(old, accepted=())), progress[1]
    state, trials = begun if context.hurried else select_and_revise(context, begun, FIRST_EFFECTS)
    if level(context, replace(state, accepted=old.accepted)) < level(context, state):
        return progress
    return state, trials


def labels(state: SearchState) -> list[str]:
    """Of what was accepted."""
    return sorted(c.label for c in state.candidates)


def add_one_by_one(context: SearchContext, progress: Progression, most: int) -> Progression:
    """Greedy forward search, as long as there is something to add."""

    def add_effect(before: Progression, taken: int) -> tuple[Progression, bool]:
        state, trials = before
        if taken and context.hurried:
            return before, False
        number = next_round(trials, state)
        found, new = one_round(context, state, number)
        if found is None:
            found, more = add_two(context, state, new, one_round, number + 1)
            new = [*(as_accepted(t, found) for t in new), *more]
        trials = (*trials, *new)
        if found is None:
            return (state, trials), False
        state = refit_accepted(context, renew(context, found))
        return (retest_numerics(context, state), trials), True

    return forward_selection(progress, add_effect, most)


def as_accepted(t: Trial, found: SearchState | None) -> Trial:
    """A trial that was refused alone, and taken with another."""
    taken = found is not None and any(a.round == t.round and a.candidate is t.candidate for a in found.accepted)
    return replace(t, rejection=None) if taken else t


def next_round(trials: Sequence[Trial], state: SearchState) -> int:
    """The number of a round that comes after what was tried and what is accepted, which need not have been tried."""
    return 1 + max([-1, *(t.round for t in trials), *(a.round for a in state.accepted)])


def one_round(context: SearchContext, state: SearchState, round: int) -> tuple[SearchState | None, list[Trial]]:
    """Screen, confirm, accept.

    Returns:
        The state with one effect more, not yet refitted (None where none is good enough), and what became of every
        candidate, in the screen's order.
    """
    done = 0.1 + 0.75 * min(round / context.settings.max_effects, 1.0)
    context.progress(f"round {round + 1}: screening", done)
    ranked = screen_candidates(context, state, round)
    context.progress(f"round {round + 1}: confirming", done + 0.06)
    chosen = shortlist(ranked, context.settings.confirm)
    found, decided = accept(state, confirm(context, state, chosen))
    by_candidate = {t.candidate: t for t in decided}
    return found, [by_candidate.get(t.candidate) or not_refitted(t) for t in ranked]


def without_motion(t: Trial) -> Trial:
    """A trial on recordings in which nothing moves."""
    return t if t.rejection else t.rejected(RejectionReason.NOT_EXCITED, "nothing moves in these recordings")


def not_refitted(t: Trial) -> Trial:
    """A trial that the screen ended, with the reason."""
    text = "its score in the screen is below those refitted"
    return t if t.rejection else t.rejected(RejectionReason.LOW_SCORE, text)

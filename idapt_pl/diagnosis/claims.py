"""A diagnosis that names no more than what keeps false discoveries at a rate that the user sets."""

from __future__ import annotations

from dataclasses import replace

from idapt_pl.diagnosis.answer.changes import ChangeReport
from idapt_pl.diagnosis.answer.false_discoveries import OUTSIDE_LIBRARY, Key, effect_probabilities, nameable
from idapt_pl.diagnosis.answer.law_result import LawReport
from idapt_pl.diagnosis.answer.result import EffectEstimate, Verdict
from idapt_pl.diagnosis.answer.summary import summarise_search
from idapt_pl.diagnosis.rounds.measurement import measure_intervals
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.diagnosis.state.search_state import refit_accepted, renew
from idapt_pl.effects.learned import LearnedForce, ResidualNetwork

OF_LAWS = (LearnedForce.name, ResidualNetwork.name)
"""Effects that a search for laws makes."""


def claim(found: Diagnosis, rate: float) -> Diagnosis:
    """The diagnosis with the effects alone of which at most ``rate`` are expected to be false; these fitted again.

    How probable the others are stays as it was: without the doubtful ones more is unexplained, which says nothing new.
    Where none is sure enough, something is missing that nobody can name.
    """
    boxes = black_boxes(found)
    probable = {e.key: e.probability for e in (*found.result.effects, *boxes) if e.probability is not None}
    kept = nameable(probable, rate)
    doubtful = [e for e in (*found.result.effects, *boxes) if e.key in probable and e.key not in kept]
    if not doubtful:
        return replace(found, result=replace(found.result, false_discovery_rate=rate))
    state, context, left_out = found.state, found.context, {e.key for e in doubtful}
    state = replace(
        state, fixed=tuple(e for e in state.fixed if e in found.declared or (e.name, e.target) not in left_out)
    )
    for a in state.accepted:
        if (a.candidate.kind.name, a.candidate.target) not in kept:
            state = state.without(a)
    state = measure_intervals(context, refit_accepted(context, renew(context, state)))
    left = summarise_search(context, state, found.trials)
    result = replace(
        found.result,
        verdict=left.verdict if kept else Verdict.UNEXPLAINED_RESIDUAL,
        error=left.error,
        effects=[with_probability(e, probable.get(e.key)) for e in left.effects],
        signature=left.signature,
        laws=without_laws_on(found.result.laws, {e.target for e in doubtful if e.effect in OF_LAWS}),
        changes=without_changes_of(found.result.changes, left_out),
        false_discovery_rate=rate,
        not_named=doubtful,
    )
    return replace(found, result=result, effects=state.effects, held_out=state.windows.held_out.windows, state=state)


def with_probability(e: EffectEstimate, probability: float | None) -> EffectEstimate:
    """An estimate with how probable it was beside the doubtful ones."""
    return replace(e, probability=probability)


def without_laws_on(laws: LawReport | None, joints: set[str]) -> LawReport | None:
    """What a search for laws came to, less laws on some joints; where none is left, nothing that they changed."""
    if laws is None or not joints:
        return laws
    left = [f for f in laws.found if f.joint not in joints]
    box = laws.network if laws.network is not None and laws.network.joint not in joints else None
    if left or box:
        return replace(laws, found=left, network=box)
    return replace(laws, found=left, network=box, needless=(), after=laws.before)


def without_changes_of(changes: ChangeReport | None, effects: set[Key]) -> ChangeReport | None:
    """What changes, less what some effects do that are not named."""
    if changes is None:
        return None
    return replace(changes, found=[f for f in changes.found if (f.effect, f.target) not in effects])


def black_boxes(found: Diagnosis) -> list[EffectEstimate]:
    """A network that stands in for a law, as an effect without parameters to read, and at most so probable."""
    probable = effect_probabilities(found.result.explanations)
    boxes = [(e.name, e.target) for e in found.state.fixed if isinstance(e, ResidualNetwork)]
    new = [key for key in boxes if key not in {(e.name, e.target) for e in found.declared}]
    return [EffectEstimate(*key, {}, probability=probable.get(key, OUTSIDE_LIBRARY)) for key in new]

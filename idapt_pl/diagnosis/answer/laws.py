"""Laws behind a diagnosis, put into its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from idapt_pl.diagnosis.answer.law_result import report_laws
from idapt_pl.diagnosis.answer.result import DiagnosisResult, Verdict
from idapt_pl.diagnosis.answer.summary import summarise_search
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.laws.search import LawSearch, laws_of
from idapt_pl.diagnosis.rounds.measurement import measure_intervals
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState


def add_laws(
    context: SearchContext, search: LawSearch, trials: Sequence[Trial], result: DiagnosisResult, seconds: float
) -> tuple[SearchState, DiagnosisResult]:
    """The state and the result with laws, where there are any; ``seconds`` that the search for them took.

    The verdict stays what it was, or becomes that no *known* effect explains the recordings where none of them is left.
    """
    state = search.state
    if search.state is not search.before:
        state = measure_intervals(context, search.state)
        search = replace(search, state=state)
        found = summarise_search(context, state, trials)
        enough = result.verdict is Verdict.EFFECTS_FOUND and len(state.accepted) > len(laws_of(state))
        verdict = result.verdict if enough else Verdict.UNEXPLAINED_RESIDUAL
        result = replace(found, verdict=verdict, next_experiment=result.next_experiment)
    return state, replace(result, laws=report_laws(context, search, seconds))

"""End stops beside other effects: looked for where a search ended, on all windows that fits are made on.

A stop stands out of what the model does not explain once the other effects are known. And a joint meets it in few
windows: the few that candidates are usually tried on may hold none of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from idapt_pl.diagnosis.candidates.responses import Responses
from idapt_pl.diagnosis.candidates.stops_shown import is_shown, stops_shown
from idapt_pl.diagnosis.rounds.look_ahead import Round
from idapt_pl.diagnosis.rounds.numerics import retest_numerics
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import Progression, SearchState, refit_accepted, renew
from idapt_pl.effects.candidate import Candidate
from idapt_pl.prediction.force_windows import judges_forces


def add_stops(context: SearchContext, progress: Progression, one_round: Round, number: int) -> Progression:
    """The stops that recordings show beside what was found, one after the other as long as one surely helps.

    Args:
        context: of the search.
        progress: where it ended, and all that was tried.
        one_round: looks for the best of them.
        number: of the next round.
    """
    state, trials = progress
    while not judges_forces(state.windows.fit) and len(state.accepted) < context.settings.max_effects:
        shown = ends_shown(context, state)
        if not shown:
            break
        among = replace(context, candidates=shown, responses=Responses())
        found, tried = one_round(among, on_all_windows(state), number)
        trials, number = (*trials, *tried), number + 1
        if found is None:
            break
        state = retest_numerics(context, refit_accepted(context, renew(context, found)))
    return state, trials


def ends_shown(context: SearchContext, state: SearchState) -> Sequence[Candidate]:
    """Ends of joints that are shown to be stops by what is left unexplained, but for those that were found."""
    if not context.ends:
        return ()
    known = {(c.label, c.names) for c in state.candidates}
    stops = stops_shown(context.sim, state.effects)
    return [c for c in context.ends if (c.label, c.names) not in known and is_shown(c, context.sim, stops)]


def on_all_windows(state: SearchState) -> SearchState:
    """The state, in which candidates are tried on all windows that fits are made on."""
    windows = state.windows
    return replace(state, windows=replace(windows, scout=windows.fit, screen=windows.fit))

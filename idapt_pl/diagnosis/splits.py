"""Does the answer hang on which episodes were held out? The search again with the others held out in turn.

In the manner of stability selection (Meinshausen and Bühlmann 2010): how often an effect is chosen tells more than how
large it is. Searches are for effects of the library; laws are not sought again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.answer.false_discoveries import Key
from idapt_pl.diagnosis.answer.split_report import SplitReport, SplitSearch
from idapt_pl.diagnosis.answer.summary import found_numerics
from idapt_pl.diagnosis.prepare import activity, begin_with, quarters
from idapt_pl.diagnosis.search import Diagnosis, run_search
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.prediction.data import UnusableData
from idapt_pl.prediction.horizon import usable_episodes


def with_splits(found: Diagnosis) -> Diagnosis:
    """A diagnosis that tells how often each effect is chosen, with each quarter of the episodes held out in turn.

    Takes as long again for every quarter but the one that was held out already.

    Raises:
        UnusableData: too few episodes to hold out others.
    """
    context = found.context
    parts = quarters(activity(context.sim.data), np.asarray(usable_episodes(context.sim.data)))
    others = [part for part in parts if not np.array_equal(part, context.held_out_episodes)]
    if not others or len(others) == len(parts):
        raise UnusableData("there are no other episodes to hold out: record at least two")
    searches = [SplitSearch(context.held_out_episodes.tolist(), chosen(context, found.state))]
    for i, part in enumerate(others):
        context.progress(f"split {i + 2} of {len(parts)}", 0.0)
        searches.append(SplitSearch(part.tolist(), search_again(found, part)))
    return replace(found, result=replace(found.result, splits=SplitReport(tuple(searches))))


def search_again(found: Diagnosis, held_out: np.ndarray) -> Mapping[Key, Mapping[str, float]]:
    """What the same search chooses with other episodes held out."""
    c = found.context
    every = np.union1d(c.fit_episodes, c.held_out_episodes)
    names = sorted({x.kind.name for x in (*c.unlimited, *c.candidates)})
    context, state = begin_with(
        c.sim, c.declared, (np.setdiff1d(every, held_out), held_out), names, c.seed, c.settings, c.progress,
        c.known_noise,
    )  # fmt: skip
    return chosen(context, run_search(context, state)[0])


def chosen(context: SearchContext, state: SearchState) -> dict[Key, dict[str, float]]:
    """Effects of the library that a search chose, with their values."""
    effects: dict[Key, dict[str, float]] = {}
    for a in state.accepted:  # both ends of a joint are one entry
        own = effects.setdefault((a.candidate.kind.name, a.candidate.target), {})
        own.update(zip(a.candidate.names, map(float, a.x), strict=True))
    return effects | {e.key: {} for e in found_numerics(context, state)}

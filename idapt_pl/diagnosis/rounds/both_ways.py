"""Where few held-out windows show an effect: also fitted to these, and judged on the windows that fits are made on.

An end stop that a joint meets in one held-out episode of four takes all of the error away there, and that is one number
to judge by. The other way round, each window is judged by a fit that has not seen it (cross-fitting).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.candidate import Candidate
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.simulator import Effects

STEPS_THE_OTHER_WAY = 5
"""Of a fit."""
MOST_OF_THE_REST = 0.5
"""Share of what is left above noise that it must take away on the held-out windows."""


def gain_on_all(
    context: SearchContext,
    state: SearchState,
    candidates: Sequence[Candidate],
    x: Sequence[np.ndarray],
    without: Effects,
    held_out: tuple[np.ndarray, np.ndarray],
    sure: float,
) -> tuple[float, float]:
    """What an effect gains, and the standard error of that; on all windows where it gains much and is not sure.

    Args:
        context: of the search.
        state: with the windows.
        candidates: effects of the model with it.
        x: their parameters, fitted to the windows that fits are made on.
        without: effects of the model without it, fitted likewise, which is no favour to the other.
        held_out: losses on the held-out windows without it and with it, (n,) each.
        sure: standard errors that a sure gain is above zero.
    """
    windows = state.windows
    episodes = windows.held_out.windows.episode
    gain, error = paired_gain(*held_out, episodes)
    left = float(held_out[0].mean())
    open_question = gain <= sure * error and left > LEFT_OVER and gain > MOST_OF_THE_REST * (left - 1)
    if not open_question or judges_forces(windows.held_out):
        return gain, error
    other = context.fit(windows.held_out, state.fixed, candidates, x, STEPS_THE_OTHER_WAY).x
    with_it = context.loss(windows.fit, (*state.fixed, *effects_of(candidates, other)))
    before = np.concatenate([held_out[0], context.loss(windows.fit, without)])
    after = np.concatenate([held_out[1], with_it])
    return paired_gain(before, after, np.concatenate([episodes, windows.fit.windows.episode]))

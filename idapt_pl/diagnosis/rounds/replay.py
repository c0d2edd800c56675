"""Replays over longer stretches than those that effects are fitted to: do effects still help there?"""

from __future__ import annotations

import numpy as np

from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.prediction.data import Windows, sample_windows

TIMES_LONGER = 5
"""How much longer these stretches are than windows, where episodes are long enough."""
REPLAYED_STRETCHES = 60
"""Of held-out episodes that are replayed, at most."""
REST = 2.0
"""Standard deviations of its noise that a channel at rest seems to move; noise alone comes to the root of two."""


def long_windows(context: SearchContext) -> Windows:
    """Stretches of the held-out episodes."""
    lengths = [len(context.sim.data[e]) for e in context.held_out_episodes]
    steps = int(max(context.steps, min(TIMES_LONGER * context.steps, 0.8 * np.median(lengths))))
    return sample_windows(context.sim.data, context.held_out_episodes, steps, 5, REPLAYED_STRETCHES, context.seed + 4)


def replay_losses(context: SearchContext, state: SearchState, windows: Windows) -> np.ndarray:
    """Error of each replay, 1 where it is as wrong as standing still would be: (n,).

    Far from the start small errors have grown. So errors are counted in units of how far each channel moves, and an
    error beyond that is no worse than another.
    """
    sim = context.sim
    residual = sim.residual(state.effects, windows)[..., sim.compared]
    moved = np.sqrt(np.mean(np.square(motion(context, windows)[..., sim.compared]), (0, 1))) + 1e-9
    return np.minimum(np.square(residual / moved), 1.0).mean((1, 2))


def motion(context: SearchContext, windows: Windows) -> np.ndarray:
    """How far channels are from where they were when a stretch began, (n, j, channels)."""
    (q0, v0), (q, v) = (context.sim.measured(windows, offsets) for offsets in (np.zeros(1, int), windows.offsets))
    return context.sim.difference((q, v), (np.repeat(q0, q.shape[1], 1), np.repeat(v0, v.shape[1], 1)))


def at_rest(context: SearchContext, state: SearchState) -> bool:
    """Whether nothing moves in held-out windows beyond the noise of its sensor, and the model has nothing move either.

    What is predicted then is noise of the measured first states, and whatever damps it predicts better.
    """
    split, noise = state.windows.held_out, state.windows.noise.sensors
    moved = np.sqrt(np.square(motion(context, split.windows)).mean((0, 1)))
    still = (moved < REST * noise)[context.sim.compared].all()
    return bool(still) and float(context.loss(split, state.effects).mean()) < LEFT_OVER


def worse_replays(context: SearchContext, with_it: SearchState, without: SearchState) -> bool:
    """Whether an effect surely makes replays over longer stretches worse."""
    windows = long_windows(context)
    if not len(windows):
        return False
    gain = replay_losses(context, without, windows) - replay_losses(context, with_it, windows)
    return bool(gain.mean() + context.settings.sureness * gain.std() / np.sqrt(len(gain)) < 0)

"""Pieces of recordings, and the share of them that is held out from fitting."""

from __future__ import annotations

import numpy as np

from datamodules.stacks import FrameStacks

LONGEST = 50
"""Control steps in a piece at most; a policy that holds on leaves one long episode, which is many pieces."""
EVERY = 5
"""One piece in so many is held out."""


def pieces(data: FrameStacks) -> np.ndarray:
    """Number of the piece that each observation belongs to, (N,): its episode, or a part of one where that is long.

    There are at least 2 × EVERY pieces, so that some are held out of the shortest recording.
    """
    steps = np.unique(data.first, return_counts=True)[1] - 1  # control steps of every episode
    longest = max(1, min(LONGEST, steps.sum() // (2 * EVERY)))
    parts = -(-steps // longest)
    before = np.cumsum(parts) - parts

    def each(values: np.ndarray) -> np.ndarray:
        return np.repeat(values, steps + 1)

    within = (np.arange(len(data)) - data.first) * each(parts) // each(steps)
    return each(before) + np.minimum(within, each(parts) - 1)  # an episode's last observation opens no new piece


def held_out(piece: np.ndarray) -> np.ndarray:
    """Which observations are held out, from their pieces: bool (N,)."""
    return piece % EVERY == EVERY - 1

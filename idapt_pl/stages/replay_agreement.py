"""Do labels by replays go with what is read of the same images? A target that moves otherwise gives itself away there.

G may draw things elsewhere, larger or smaller, and readings still rise and fall with where things are. Where commands
are turned, swapped or of another sign they do not, and labels by replays would teach the encoder what is not so.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import numpy as np

from datamodules.on_policy import encode_all
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.stages.context import StageContext

log = logging.getLogger(__name__)

AGREEING = 0.5
"""Median correlation below which a run warns.

Sawyer-Push has 0.61 to 0.90 as it is (five seeds, eleven steps), and 0.70, 0.64, 0.27 and -0.19 with commands turned by
0.5, 1.0, 1.6 and 3.1 rad where it has 0.92 (seed 8, 30 recordings): quarter turns, swaps and signs are noticed, small
turns are not."""

FEWEST_LABELS = 50
"""Labels of a component that say something."""


def agreement(readings: np.ndarray, labels: np.ndarray, left_out: Collection[int] = ()) -> np.ndarray:
    """Correlation (s,) of readings and labels (n, s) of each component; NaN where it has few labels or none that vary.

    Args:
        readings: of images.
        labels: of the same images; NaN where there is none.
        left_out: components that get NaN.
    """
    found = np.full(labels.shape[1], np.nan)
    for i in set(range(len(found))) - set(left_out):
        told = ~np.isnan(labels[:, i])
        pair = readings[told, i].astype(float), labels[told, i].astype(float)
        if told.sum() >= FEWEST_LABELS and min(p.std() for p in pair) > 1e-6:
            found[i] = np.corrcoef(*pair)[0, 1]
    return found


def warn_if_read_otherwise(c: StageContext, step: int, labelled: Path, pi: AsymmetricSAC) -> None:
    """``replay_agreement.json``: how readings of π's encoder go with labels by replays; a warning if they do not."""

    def make(seed: int) -> dict:
        data = read_all([labelled], also="state")
        stacks = FrameStacks(data, pi.hparams.frame_stack, labels="state")
        assert stacks.labels is not None  # asked for
        readings = encode_all(stacks, pi.encode).numpy()
        found = agreement(readings, stacks.labels, c.worlds.task.rates)  # rates are read less well than what moves
        if np.isnan(found).all():
            return {"components": [], "median": None}
        return {"components": [None if np.isnan(r) else round(float(r), 3) for r in found],
                "median": round(float(np.nanmedian(found)), 3)}  # fmt: skip

    median = c.stages.measure(step, "replay_agreement", make)["median"]
    if median is not None and median < AGREEING:
        log.warning(
            "step %d  what is read of the target's images goes with where the same actions bring the source by %.2f "
            "only (correlation, 1 is alike). Either the target follows its commands otherwise: then look for effects "
            "(effects.discover), or set labels.replays 0. Or G draws it elsewhere", step, median,
        )  # fmt: skip

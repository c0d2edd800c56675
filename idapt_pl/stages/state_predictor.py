"""The stage of P^S: states from labelled source images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from datamodules import LabelledImages
from idapt_pl.modules import StatePredictor
from idapt_pl.stages.context import StageContext, continued


def fit_P_S(
    c: StageContext,
    step: int,
    source: Sequence[Path],
    batches: int,
    initial: StatePredictor | None = None,
    name: str = "state_predictor",
) -> StatePredictor:
    """P^S on labelled source images, from scratch or continued from ``initial``.

    Args:
        c: of the run.
        step: grounding step.
        source: trajectory files with images and states.
        batches: gradient steps.
        initial: what it goes on from.
        name: of the stage.
    """

    def feed(module: StatePredictor, seed: int, device: torch.device) -> LabelledImages:
        return LabelledImages(source, c.worlds.frame_stack, c.batches.state_predictor_batch, batches, seed)

    as_before = {} if initial is None else {"relight": initial.hparams.relight}  # π's encoder learns in other lights
    build = continued(lambda: c.make.state_predictor(**c.worlds.dimensions, **as_before), initial)
    return c.stages.fit(step, name, build, feed, batches)

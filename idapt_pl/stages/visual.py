"""The stage of G and P^T: unpaired images of source and target (Section IV-C1)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from datamodules import UnpairedImages
from idapt_pl.modules import StatePredictor, VisualTransformation
from idapt_pl.stages.context import StageContext, continued


def fit_G(
    c: StageContext,
    step: int,
    source: Sequence[Path],
    target: Sequence[Path],
    batches: int,
    P_S: StatePredictor,
    initial: VisualTransformation | None = None,
    replayed: Path | None = None,
    name: str = "visual",
) -> VisualTransformation:
    """G with P^T on unpaired images; P^T starts as a copy of P^S.

    Args:
        c: of the run.
        step: grounding step.
        source: trajectory files with images and states.
        target: trajectory files with images; nothing else of them is used.
        batches: gradient steps of the generators.
        P_S: fitted to the same source files.
        initial: the G that this one goes on from.
        replayed: the source's file of what the target's actions do there at first, or None.
        name: of the stage.
    """

    def build() -> VisualTransformation:
        module = continued(lambda: c.make.visual(**c.worlds.dimensions), initial)()
        if batches or initial is None:  # else P^T stays what was trained with this G
            module.adopt(P_S.P_S)
        return module

    def feed(module: VisualTransformation, seed: int, device: torch.device) -> UnpairedImages:
        stack, size = c.worlds.frame_stack, c.batches.visual_batch
        resets = max(1, size // 4) if module.hparams.reset_weight else 0
        return UnpairedImages(source, target, stack, size, batches, seed, resets, replayed)

    return c.stages.fit(step, name, build, feed, batches)

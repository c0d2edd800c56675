"""Whether the target ends a policy's episodes much sooner than the grounded source does."""

from __future__ import annotations

import logging
from pathlib import Path
from statistics import median

from datamodules import read_trajectories
from idapt_pl.stages.context import StageContext

log = logging.getLogger(__name__)

SOONER = 1 / 3
"""Share of the source's usual length below which episodes of the target are ended sooner."""


def warn_if_ended_sooner(c: StageContext, k: int, source: Path, target: Path) -> None:
    """Say so if the target ends episodes that the grounded source goes on with.

    Then what is seen of the target, or the source's physics, is still wrong, though no loss tells. Nothing but the ends
    of episodes is looked at, which any target shows. Those of recordings that people brought may have other reasons.

    Args:
        c: of the run.
        k: grounding step.
        source: trajectory file of the policy in the grounded source.
        target: likewise of the target.
    """
    if not c.worlds.target.playable:
        return
    in_target, in_source = (median(lengths_of(path)) for path in (target, source))
    if in_target < SOONER * in_source:
        log.warning(
            "step %d  episodes of this policy last %d control steps in the target and %d in the grounded source "
            "(medians; target.h5 and source.h5 of step_%02d): images of the target are read wrongly, or the source's "
            "physics is wrong. More schedule.grounding_steps may help, and with exploration: rehearse "
            "schedule.exploration_strays",
            k, round(in_target), round(in_source), k,
        )  # fmt: skip


def lengths_of(recording: Path) -> list[int]:
    """Control steps of each episode of a trajectory file, without the last if it may have been left unfinished."""
    lengths = [len(episode) for episode in read_trajectories(recording)]
    return lengths[:-1] or lengths

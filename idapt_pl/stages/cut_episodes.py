"""Exploring episodes, cut where they are lost: what the target shows from there on, no image of the source shows.

Exploration has no feedback. Where the target falls and the source does not, half of what the one shows has no
counterpart in the other, and G, which takes both sets of images for the same motions, learns to draw neither. No loss
of G tells. But physics does, once it goes along with what is read of the target's images and finds in most episodes
that from some control step on they no longer agree. Then the recordings of both are cut there, and all that was made of
their ends is made again, without another step of the target (docs/decisions/078).
"""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

from datamodules import Trajectories, read_trajectories
from idapt_pl.files import read_json, write_json
from idapt_pl.run_folder.results import REPAIRED, UNCUT
from idapt_pl.stages.context import StageContext

log = logging.getLogger(__name__)

CUT = "cut"
"""The stage that says after how many control steps."""
WHERE_LOST = "lost"
"""The stage that says where recordings are lost (:mod:`idapt_pl.stages.labels`)."""
MADE_AGAIN = (
    "replayed", "visual", "translated", "moved_translated", "estimator", "control", "effects", "known_start_search",
    *(f"{REPAIRED}{name}" for name in ("source", "replayed", "visual", "translated", "moved_translated", "estimator")),
    "reading_offsets", "reading_errors", "labelled", WHERE_LOST,
)  # fmt: skip
"""Stages of step 0 that learn from the recordings, the one that is asked whether to cut the last."""


def cut_horizon(c: StageContext) -> int | None:
    """Control steps after which exploring episodes were cut; None if they were not."""
    return c.stages.read(0, CUT)["steps"] if (c.stages.folder(0) / f"{CUT}.json").exists() else None


def as_cut(c: StageContext, files: tuple[Path, ...]) -> tuple[Path, ...]:
    """Recordings of exploration up to where they were cut, as ``<name>_cut.h5``; as they are if they were not."""
    if (steps := cut_horizon(c)) is None:
        return files
    put_aside(c.stages.folder(0))
    return tuple(c.stages.record(0, f"{f.stem}_cut", partial(first_steps, f, steps))[0] for f in files)


def first_steps(path: Path, steps: int, seed: int) -> Trajectories:
    """The first control steps of every episode of a trajectory file; nothing is drawn."""
    recorded = read_trajectories(path)
    episodes = tuple(episode.part(0, min(steps, len(episode))) for episode in recorded)
    return replace(recorded, episodes=episodes, source=f"{recorded.source}, cut after {steps} steps")


def to_be_cut(c: StageContext, step: int) -> bool:
    """Whether recordings of a step that are lost on their way will be cut there."""
    return step == 0 and cut_horizon(c) is None


def cut_where_lost(c: StageContext) -> bool:
    """Cut what was explored, once, if most of its episodes begin well and are lost on their way.

    Then what was made of them is put aside, as ``uncut_<name>``. Returns whether it was cut.
    """
    folder = c.stages.folder(0)
    if not to_be_cut(c, 0) or not (folder / f"{WHERE_LOST}.json").exists():
        return False
    if (steps := c.stages.read(0, WHERE_LOST)["from"]) is None:
        return False
    log.warning(
        "exploring episodes are cut after %d control steps, as most are lost from there on, and G is learned again: in "
        "the target they show what they do not in the source (such as a fall, see target.h5). With "
        "schedule.exploration_horizon %d all frames would be of use",
        steps, steps,
    )  # fmt: skip
    c.stages.measure(0, CUT, lambda seed: {"steps": steps})
    put_aside(folder)
    if c.stages.time_left is not None:
        c.stages.time_left.again(0, MADE_AGAIN)
    return True


def put_aside(folder: Path) -> None:
    """Give what is to be made again other names; what has them already is left, so a killed process did no harm."""
    if not (folder / f"{WHERE_LOST}.json").exists() or (folder / f"{UNCUT}{WHERE_LOST}.json").exists():
        return
    for name in MADE_AGAIN:
        for path in (folder / f"{name}.h5", folder / name, folder / f"{name}.json"):
            if path.exists():
                rename(path, folder / f"{UNCUT}{path.name}")


def rename(path: Path, new: Path) -> None:
    """Rename a recording, a result or a stage's folder, and the stage in what is said of it, which stays as old."""
    about = path / "stage.json" if path.is_dir() else path
    if about.suffix == ".json" and about.exists():
        made = about.stat()
        write_json(about, read_json(about) | {"stage": new.stem}, checked=True)
        os.utime(about, ns=(made.st_atime_ns, made.st_mtime_ns))  # by which it is told when the stage was at work
    path.rename(new)

"""From a recording of the target to the visual effects that its source lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datamodules.trajectories import open_trajectory_file
from idapt_pl.appearance.result import VisualEffects
from idapt_pl.appearance.search import find_visual_effects
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.tasks import Task


def discover_visual_effects(task: Task, source: Domain, target: Path, seed: int, view: View = WHOLE) -> VisualEffects:
    """Find visual effects in a trajectory file of the target. Arguments and errors as of :func:`find_visual_effects`.

    Raises:
        ValueError: also if an episode has no images.
    """
    return find_visual_effects(task, source, first_frames(target), seed, view)


def first_frames(path: Path) -> np.ndarray:
    """The first frame of every episode of a trajectory file: uint8 (n, H, W, 3).

    Raises:
        ValueError: if an episode has no images.
    """
    with open_trajectory_file(path) as f:
        names = [f"episode_{i}/observations/pixels" for i in range(int(f.attrs["total_episodes"]))]
        if missing := [name for name in names if name not in f]:
            raise ValueError(f"{path}: there is no {missing[0]}; visual effects are found in images")
        return np.stack([f[name][0] for name in names])

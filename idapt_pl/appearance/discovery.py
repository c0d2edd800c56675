"""From a recording of the target to the visual effects that a grounding step adds, as JSON."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from datamodules.trajectories import open_trajectory_file
from idapt_pl.appearance.parameters import VisualParameter
from idapt_pl.appearance.search import find_visual_effects
from idapt_pl.effects import WHOLE, Domain, View
from idapt_pl.tasks import Task


def discover_visual_effects(task: Task, source: Domain, target: Path, seed: int, view: View = WHOLE) -> dict:
    """Find visual effects in a trajectory file of the target. Arguments as for :func:`find_visual_effects`.

    Returns:
        ``effects`` found (a list as in effects.yaml); their ``estimates``, with standard deviations; errors ``before``
        and ``after`` on episodes held out and the noise ``floor``, root mean square, in 8-bit levels; the ``trail`` of
        the search; and the mean pictures of source, repaired source and target as a ``picture``, a PNG in base64.
    """
    looks = find_visual_effects(task, source, first_frames(target), seed, view)
    spec = source.spec()

    def named(knob: VisualParameter, values: np.ndarray) -> dict[str, float]:
        return dict(zip(knob.labels, values.tolist(), strict=True))

    return {
        "effects": [e.to_dict() for k, v in looks.settings.items() for e in k.effects(spec, v)],
        "estimates": [
            {"effect": k.name, "target": k.target, "unit": k.unit, "nominal": named(k, k.nominal),
             "estimate": named(k, v), "std": named(k, looks.spread[k])}
            for k, v in looks.settings.items()
        ],
        "before": looks.before, "after": looks.after, "floor": looks.floor, "trail": looks.trail,
        "picture": images_in_a_row(looks.pictures),
    }  # fmt: skip


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


def images_in_a_row(pictures: Sequence[np.ndarray]) -> str:
    """Pictures (H, W, 3), 0 to 1, in a row, as a PNG in base64."""
    row = np.rint(255 * np.concatenate(pictures, 1).clip(0, 1)).astype(np.uint8)
    return base64.b64encode(iio.imwrite("<bytes>", row, extension=".png")).decode()

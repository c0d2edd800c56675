"""Pictures of a grounding step, from its trajectory files and the checkpoint of its G."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datamodules.trajectories import open_trajectory_file
from idapt_pl.modules import VisualTransformation

SEARCHED_FRAMES = 200
"""Target frames among which the most similar one is looked for."""


@dataclass(frozen=True)
class TranslatedExamples:
    """Source frames, what G makes of them, and real target frames most like that: uint8, (n, H, W, 3) each."""

    source: np.ndarray
    translated: np.ndarray
    target: np.ndarray


def spread_stacks(path: Path, count: int, frame_stack: int) -> np.ndarray:
    """Frame stacks spread evenly over a trajectory file, without reading the rest: uint8 (n, K, H, W, 3)."""
    with open_trajectory_file(path) as f:
        groups = [f[f"episode_{i}"] for i in range(int(f.attrs["total_episodes"]))]
        lengths = np.array([len(g["observations/pixels"]) for g in groups])
        starts = np.cumsum(lengths) - lengths
        chosen = np.unique(np.linspace(0, lengths.sum() - 1, count + 2).round().astype(int)[1:-1])
        episodes = np.searchsorted(starts, chosen, "right") - 1
        return np.stack(
            [
                [groups[e]["observations/pixels"][max(0, t - lag)] for lag in range(frame_stack - 1, -1, -1)]
                for e, t in zip(episodes, chosen - starts[episodes], strict=True)
            ]
        )


def translated_examples(source: Path, target: Path, G: VisualTransformation, count: int = 4) -> TranslatedExamples:
    """What G did with some frames of a recording of the source.

    Args:
        source: trajectory file with source images.
        target: trajectory file with target images.
        G: the visual transformation.
        count: how many frames.
    """
    stacks = spread_stacks(source, count, G.frames)
    translated = G.translate(stacks)[:, -1]
    real = spread_stacks(target, SEARCHED_FRAMES, 1)[:, 0]
    distances = [np.abs(real.astype(np.int16) - image).mean((1, 2, 3)) for image in translated.astype(np.int16)]
    return TranslatedExamples(stacks[:, -1], translated, real[np.argmin(distances, 1)])

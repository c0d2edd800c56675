"""An estimator of the state as a sensor: what it reads from recordings of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from datamodules import Episode, Trajectories
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.tasks import Task


def readings(
    files: Sequence[Path],
    predictor: PixelStatePredictor,
    task: Task,
    frame_stack: int,
    G: VisualTransformation | None = None,
) -> Trajectories:
    """Recordings as a sensor of positions gives them: ``qpos`` and actions.

    Args:
        files: trajectory files with images.
        predictor: the sensor.
        task: knows positions from states.
        frame_stack: images that the sensor sees at a time.
        G: shows the sensor source images as target images; None for target images.

    Raises:
        ValueError: if positions cannot be told from the task's states.
    """
    data, read = read_all(files), []
    for episode in data if G is None else (seen_through(G, e) for e in data):
        states = estimates(FrameStacks([episode], frame_stack), predictor)
        read.append(Episode(episode.actions, {"qpos": task.positions(states, data.dt)}))
    return Trajectories(tuple(read), data.dt, "positions read from images")


@torch.no_grad()
def estimates(images: FrameStacks, predictor: PixelStatePredictor, chunk: int = 256) -> np.ndarray:
    """What a sensor takes for the states that images show, (n, s), in their units."""
    device = next(predictor.parameters()).device
    parts = np.array_split(np.arange(len(images)), len(images) // chunk + 1)
    seen = (torch.from_numpy(images.stacks(p)).to(device) for p in parts)
    return np.concatenate([predictor.predict(s).cpu().numpy() for s in seen]).astype(float)


def seen_through(G: VisualTransformation, episode: Episode) -> Episode:
    """An episode of the source as G shows it (the newest frame, where G sees stacks), with its states."""
    pixels = episode.observations["pixels"]
    if G.frames > 1:
        stacks = FrameStacks([episode], G.frames).stacks(np.arange(len(pixels)))
        pixels = G.translate(stacks)[:, -1]
    else:
        pixels = G.translate(pixels[:, None])[:, 0]
    return replace(episode, observations={**episode.observations, "pixels": pixels})

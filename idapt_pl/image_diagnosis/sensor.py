"""An estimator of the state as a sensor: what it reads from recordings of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from datamodules import Episode, Trajectories
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.modules import VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.tasks import Task


@dataclass(frozen=True)
class ImageSensor:
    """A predictor of states, as a sensor of positions and velocities.

    Args:
        predictor: reads target images.
        task: knows positions and velocities from states.
        frame_stack: images that the predictor sees at a time.
    """

    predictor: PixelStatePredictor
    task: Task
    frame_stack: int

    def read(self, files: Sequence[Path], G: VisualTransformation | None = None) -> Trajectories:
        """Recordings as the sensor gives them: ``qpos``, ``qvel`` and actions; ``state`` too where it is there.

        Args:
            files: trajectory files with images.
            G: shows the sensor source images as target images; None for target images.

        Raises:
            ValueError: if the task's states do not tell positions.
        """
        data, read = read_all(files, also="state" if G else None), []
        for episode in data:
            qpos, qvel = self.motion(episode, data.dt, G)
            known = {"state": episode.observations["state"]} if G else {}
            read.append(Episode(episode.actions, {"qpos": qpos, "qvel": qvel} | known))
        return Trajectories(tuple(read), data.dt, "read from images")

    def motion(self, episode: Episode, dt: float, G: VisualTransformation | None) -> tuple[np.ndarray, np.ndarray]:
        """``qpos`` (T+1, nq) and ``qvel`` (T+1, nv) of one episode; ``G`` shows the sensor source images."""
        images = FrameStacks([episode if G is None else G.translate_episode(episode)], self.frame_stack)
        return self.task.motion(estimate_states(images, self.predictor), dt)


@torch.no_grad()
def estimate_states(images: FrameStacks, predictor: PixelStatePredictor, chunk: int = 256) -> np.ndarray:
    """The states that a predictor reads off images, (n, s), in their units; ``chunk`` stacks at a time."""
    device = next(predictor.parameters()).device
    parts = np.array_split(np.arange(len(images)), len(images) // chunk + 1)
    stacks = (torch.from_numpy(images.stacks(p)).to(device) for p in parts)
    return np.concatenate([predictor.predict(s).cpu().numpy() for s in stacks]).astype(float)

"""An estimator of the state as a sensor: what it reads from recordings of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import torch

from datamodules import Episode, Trajectories
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.diagnosis.data import difference, slopes
from idapt_pl.diagnosis.statistics import Noise
from idapt_pl.modules import VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.tasks import Task


@dataclass(frozen=True)
class Sensor:
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
        for episode in data if G is None else (seen_through(G, e) for e in data):
            states = estimates(FrameStacks([episode], self.frame_stack), self.predictor)
            qpos, qvel = self.task.motion(states, data.dt)
            known = {"state": episode.observations["state"]} if G else {}
            read.append(Episode(episode.actions, {"qpos": qpos, "qvel": qvel} | known))
        return Trajectories(tuple(read), data.dt, "read from images")


@dataclass(frozen=True)
class Calibration:
    """How far a sensor is off, root mean square, on frames whose state is known.

    Attributes:
        position: m or rad, (nv,).
        velocity: as read, m/s or rad/s, (nv,).
        slope: of velocities that are central slopes of the positions read, (nv,).
    """

    position: np.ndarray
    velocity: np.ndarray
    slope: np.ndarray

    @property
    def reads_velocities(self) -> bool:
        """Whether velocities as read are nearer to the truth than slopes of positions, for most joints."""
        return bool(np.median(self.velocity / np.maximum(self.slope, 1e-12)) < 1.0)

    @property
    def noise(self) -> Noise:
        """The errors as noise of what is compared, and of the states that windows begin with."""
        if self.reads_velocities:
            both = np.concatenate([self.position, self.velocity])
            return Noise(both, both)
        return Noise(self.position, np.concatenate([self.position, self.slope]))


def compared(read: Trajectories, calibration: Calibration) -> Trajectories:
    """What is compared of what a sensor read: positions, and velocities where they are better than slopes."""
    names = ("qpos", "qvel") if calibration.reads_velocities else ("qpos",)
    episodes = tuple(replace(e, observations={n: e.observations[n] for n in names}) for e in read)
    return replace(read, episodes=episodes)


def calibrate(task: Task, model: mujoco.MjModel, read: Trajectories) -> Calibration:
    """The errors of what a sensor read from source images, whose states are known."""
    errors: list[tuple[np.ndarray, ...]] = []
    for episode in read:
        seen = episode.observations
        qpos, qvel = task.motion(np.asarray(seen["state"], float), read.dt)
        sloped = slopes(model, read.dt * np.arange(len(qpos)), seen["qpos"])
        errors.append((difference(model, qpos, seen["qpos"]), seen["qvel"] - qvel, sloped - qvel))
    return Calibration(*(np.sqrt(np.square(np.concatenate(e)).mean(0)) for e in zip(*errors, strict=True)))


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

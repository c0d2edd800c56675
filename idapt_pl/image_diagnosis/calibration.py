"""How far an image sensor is off, measured on images of the source whose states are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.effects import Domain
from idapt_pl.effects.signals import SensorGain
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.modules import VisualTransformation
from idapt_pl.prediction.data import position_difference, slopes
from idapt_pl.prediction.noise import Noise
from idapt_pl.tasks import Task

GAIN_STD = 0.05
"""Standard deviation of what is read of a joint's motion over what it is, on target images.

On the control it is measured, and comes out as one. What G does to the geometry no control shows: 25 recordings of the
pendulum's target by five sensors were 0.05 off at the hinge and 0.02 at the slider, root mean square
(``benchmarks/sensor_errors.py``, ``results/sensor_errors.csv``). The larger is taken for every joint."""

SCALAR_JOINTS = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
"""Joint types whose position is one number."""

VELOCITY_ERROR_LIMIT = 1 / 3
"""Share of the spread of speeds above which errors of speeds say that most of what is read is what is likely in the
source. It is then no evidence against the source: an armature makes it look like friction. The pendulum's are at 0.13,
HalfCheetah's at 0.3 to 0.9."""

FAMILIAR_RANGE = 3.5
"""Spreads from the mean of the source's positions; further out there was hardly a frame to learn from."""


@dataclass(frozen=True)
class Calibration:
    """How far a sensor is off on frames whose state is known; root mean square but for bias and lag, (nv,) each.

    Attributes:
        position: m or rad.
        velocity: as read, m/s or rad/s.
        slope: of velocities that are central slopes of the positions read.
        speed: no error: the velocities themselves.
        bias: mean error of positions, m or rad. Part of ``position``; not taken off, as the target's is another.
        lag: by how much positions trail the motion, s; likewise.
    """

    position: np.ndarray
    velocity: np.ndarray
    slope: np.ndarray
    speed: np.ndarray
    bias: np.ndarray
    lag: np.ndarray

    @property
    def velocities_unreliable(self) -> bool:
        """Whether the speeds of most joints cannot be told, neither as read nor from slopes of positions."""
        best = np.minimum(self.velocity, self.slope)
        return bool(np.median(best / np.maximum(self.speed, 1e-12)) >= VELOCITY_ERROR_LIMIT)

    @property
    def reads_velocities(self) -> bool:
        """Whether velocities as read are near the truth, and nearer than slopes of positions, for most joints."""
        better = np.median(self.velocity / np.maximum(self.slope, 1e-12)) < 1.0
        return bool(better) and not self.velocities_unreliable

    def noise(self, model: mujoco.MjModel, unseen: Sequence[str]) -> Noise:
        """The errors as noise of what is compared, and of the states that windows begin with; gains are unknown."""
        scalar = np.flatnonzero(np.isin(model.jnt_type, SCALAR_JOINTS))
        names = (model.joint(j).name for j in scalar)
        gains = tuple(SensorGain(name, 1 + GAIN_STD) for name in names if name not in unseen)
        if self.reads_velocities:
            both = np.concatenate([self.position, self.velocity])
            return Noise(both, both, gains)
        return Noise(self.position, np.concatenate([self.position, self.slope]), gains)

    def to_dict(self, model: mujoco.MjModel, unseen: Sequence[str]) -> dict[str, list[float | None]]:
        """For JSON: its arrays, five digits each, with None for positions of joints in ``unseen``.

        Args:
            model: of the source.
            unseen: names of joints whose positions no state tells.
        """
        hidden = {int(model.joint(name).dofadr[0]) for name in unseen}

        def with_gaps(name: str, errors: np.ndarray) -> list[float | None]:
            blank = hidden if name in ("position", "bias", "lag") else ()
            return [None if i in blank else round(float(e), 5) for i, e in enumerate(errors)]

        return {name: with_gaps(name, errors) for name, errors in vars(self).items()}


def reliable_channels(read: Trajectories, calibration: Calibration) -> Trajectories:
    """What is used of what a sensor read: positions, and velocities where they are read well."""
    names = ("qpos", "qvel") if calibration.reads_velocities else ("qpos",)
    episodes = tuple(replace(e, observations={n: e.observations[n] for n in names}) for e in read)
    return replace(read, episodes=episodes)


def calibrate(task: Task, model: mujoco.MjModel, read: Trajectories) -> Calibration:
    """The errors of what a sensor read from source images, whose states are known."""
    position, velocity, slope, speed = reading_errors(task, model, read)
    about = speed - speed.mean(0)
    lag = -(about * position).mean(0) / np.maximum(np.square(about).mean(0), 1e-12)

    def rms(errors: np.ndarray) -> np.ndarray:
        return np.sqrt(np.square(errors).mean(0))

    return Calibration(rms(position), rms(velocity), rms(slope), rms(speed), position.mean(0), lag)


def reading_errors(task: Task, model: mujoco.MjModel, read: Trajectories) -> list[np.ndarray]:
    """Errors of positions, velocities and slopes of positions, and the velocities that were there, (n, nv) each."""
    parts = []
    for episode in read:
        readings = episode.observations
        qpos, qvel = task.motion(np.asarray(readings["state"], float), read.dt)
        sloped = slopes(model, read.dt * np.arange(len(qpos)), readings["qpos"])
        errors = position_difference(model, qpos, readings["qpos"]), readings["qvel"] - qvel, sloped - qvel
        parts.append((*errors, qvel))
    return [np.concatenate(p) for p in zip(*parts, strict=True)]


@dataclass(frozen=True)
class CalibratedReadings:
    """What a calibrated sensor read.

    Attributes:
        target: positions, and velocities where they are read well (:attr:`Calibration.reads_velocities`).
        control: likewise, of the source.
        calibration: on the control.
        excluded_frames: shares of the frames that were left out, of ``target`` and ``control``.
        unmeasured: channels that nothing is judged by (``unmeasured`` of :func:`~idapt_pl.diagnosis.diagnose`).
    """

    target: Trajectories
    control: Trajectories
    calibration: Calibration
    excluded_frames: dict[str, float]
    unmeasured: tuple[str, ...]


def read_calibrated(
    sensor: ImageSensor, source: Domain, target: Sequence[Path], control: Sequence[Path], G: VisualTransformation
) -> CalibratedReadings:
    """Read recordings of the target, and learn from the source's how far that is off.

    Args:
        sensor: reads target images.
        source: the domain that it knows.
        target: trajectory files; images and actions are all that is used.
        control: trajectory files of the source with images and states; best such that the sensor was not fitted to.
        G: shows source images as target images.
    """
    task, model = sensor.task, source.compile()
    given = {"target": sensor.read(target), "control": sensor.read(control, G)}
    kept = {k: familiar_frames(task, model, read, given["control"]) for k, read in given.items()}
    excluded = {k: 1 - frame_count(kept[k]) / frame_count(given[k]) for k in given}
    calibration = calibrate(task, model, kept["control"])
    reliable = {k: reliable_channels(read, calibration) for k, read in kept.items()}
    return CalibratedReadings(reliable["target"], reliable["control"], calibration, excluded, tuple(task.unseen))


def frame_count(read: Trajectories) -> int:
    """Observations of all episodes together."""
    return sum(len(e) + 1 for e in read)


def familiar_frames(task: Task, model: mujoco.MjModel, read: Trajectories, known: Trajectories) -> Trajectories:
    """What a sensor read, without frames that show what it hardly saw when it was fitted: episodes end before them.

    A few such frames would make up most of its root mean square error. Where most frames are such, all are kept.

    Args:
        task: whose ``unseen`` joints do not count.
        model: of the source.
        read: by the sensor.
        known: what it read of the source, with states; they tell what is familiar.
    """
    motions = (task.motion(np.asarray(e.observations["state"], float), known.dt)[0] for e in known)
    qpos = np.concatenate(list(motions))
    mean, counts = qpos.mean(0), [model.joint(j).name not in task.unseen for j in model.dof_jntid]
    limit = FAMILIAR_RANGE * position_difference(model, mean, qpos).std(0)
    distances = (np.abs(position_difference(model, mean, e.observations["qpos"])) for e in read)
    familiar = [(x <= limit)[:, counts].all(1) for x in distances]
    if np.concatenate(familiar).mean() < 0.5:
        return read
    kept = [sub_episode(e, *run) for e, ok in zip(read, familiar, strict=True) for run in true_runs(ok)]
    return replace(read, episodes=tuple(kept))


def true_runs(ok: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of every run of two or more True in ``ok`` (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ok.astype(int), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a > 1]


def sub_episode(episode: Episode, begin: int, end: int) -> Episode:
    """The frames from ``begin`` to before ``end``."""
    frames = {name: values[begin:end] for name, values in episode.observations.items()}
    return Episode(episode.actions[begin : end - 1], frames)

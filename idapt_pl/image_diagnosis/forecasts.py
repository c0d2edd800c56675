"""How well a source with some effects tells beforehand what a sensor reads of the target.

The commands of the target's recordings are played in it from resets, several times over. What it looks like is seen
through G and read by the same sensor, so that what G and the sensor get wrong is on both sides of the comparison, and
windows need not begin with velocities that no image shows. Episodes must begin alike in both domains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from datamodules import Episode
from idapt_pl.diagnosis.data import position_difference
from idapt_pl.effects import Domain
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.estimation.energy import energy_score
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE
from idapt_pl.modules import VisualTransformation
from idapt_pl.tasks import Task

ENSEMBLE = 4
"""Of an ensemble: how often commands are played, each time from another reset."""

FORECAST_STEPS = 20
"""Control steps that are forecast: what follows says ever less, since contacts multiply what resets differ by."""

FORECAST_EPISODES = 12
"""That are forecast."""


@dataclass(frozen=True)
class ObservedStart:
    """The beginning of an episode as a sensor read it: commands (T, nu) and what is compared, (T+1, d)."""

    commands: np.ndarray
    read: np.ndarray


@dataclass(frozen=True)
class Forecaster:
    """What was read of the target, and how to forecast it.

    Attributes:
        sightings: of the target.
        make_env: simulations of a domain side by side, a member of an ensemble each.
        shown: what of their observations is kept, (members, ...).
        read: what is compared, (t+1, d), of what a member showed while commands (t, nu) were played.
        scale: of what is compared, (d,).
    """

    sightings: tuple[ObservedStart, ...]
    make_env: Callable[[Domain], VectorImageEnv]
    shown: Callable[[dict[str, np.ndarray]], np.ndarray]
    read: Callable[[np.ndarray, np.ndarray], np.ndarray]
    scale: np.ndarray

    def ensembles(self, domain: Domain, seed: int, count: int | None = None) -> list[np.ndarray]:
        """What the first ``count`` sightings were to be expected to show in a domain, (members, T+1, d) each.

        Resets are those of the seed whatever the domain is.
        """
        with closing(self.make_env(domain)) as env:
            played = [
                play_commands(env, s.commands, seed + k, self.shown) for k, s in enumerate(self.sightings[:count])
            ]
        pairs = zip(self.sightings, played, strict=False)
        return [
            np.stack([pad_with_last(self.read(x, s.commands[: len(x) - 1]), len(s.read)) for x in members])
            for s, members in pairs
        ]

    def scores(self, domain: Domain, seed: int, count: int | None = None) -> np.ndarray:
        """Energy score of every sighting in a domain, (n,); less is better."""
        return self.scores_of(self.ensembles(domain, seed, count))

    def scores_of(self, expected: Sequence[np.ndarray]) -> np.ndarray:
        """Energy scores of :meth:`ensembles`, (n,)."""
        pairs = zip(expected, self.sightings, strict=False)
        return np.array([energy_score(x / self.scale, s.read / self.scale) for x, s in pairs])

    def errors_of(self, expected: Sequence[np.ndarray]) -> np.ndarray:
        """Root mean square of what was read less the means of :meth:`ensembles`, of each thing compared, (d,)."""
        pairs = zip(expected, self.sightings, strict=True)
        return np.sqrt(np.mean(np.concatenate([np.square(x.mean(0) - s.read)[1:] for x, s in pairs]), 0))


def play_commands(
    env: VectorImageEnv, commands: np.ndarray, seed: int, shown: Callable[[dict[str, np.ndarray]], np.ndarray]
) -> list[np.ndarray]:
    """What simulations show when commands (T, nu) are played from resets, (t+1, ...) each.

    Fewer than T+1 where an episode was over before.
    """
    obs, _ = env.reset(seed=seed)
    kept, running = [[x] for x in shown(obs)], np.ones(env.num_envs, bool)
    for command in commands:
        obs, _, terminations, truncations, infos = env.step(np.repeat(command[None], env.num_envs, 0))
        over = terminations | truncations
        newest = shown(infos["final_obs"] if over.any() else obs)
        for i in np.flatnonzero(running):
            kept[i].append(newest[i])
        running &= ~over
        if not running.any():
            break
    return [np.stack(x) for x in kept]


def pad_with_last(x: np.ndarray, length: int) -> np.ndarray:
    """A sequence made so long by its last row: what was over before stays as it was."""
    return np.concatenate([x, np.repeat(x[-1:], length - len(x), 0)])


class ComparedChannels:
    """What is compared of a motion: positions and velocities of the joints that a state tells of.

    Args:
        task: whose states they are.
        model: likewise.
    """

    def __init__(self, task: Task, model: mujoco.MjModel) -> None:
        self.task, self.model = task, model
        self.dofs = np.array([i for i, j in enumerate(model.dof_jntid) if model.joint(j).name not in task.unseen])

    def positions(self, qpos: np.ndarray) -> np.ndarray:
        """From the model's own, (n, dofs)."""
        return position_difference(self.model, self.model.qpos0, qpos)[:, self.dofs]

    def __call__(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """(n, 2 dofs)."""
        return np.concatenate([self.positions(qpos), qvel[:, self.dofs]], 1)


def observed_starts(
    sensor: ImageSensor,
    episodes: Sequence[Episode],
    dt: float,
    compared: ComparedChannels,
    G: VisualTransformation | None = None,
) -> tuple[ObservedStart, ...]:
    """The beginnings of episodes, as a sensor reads them; ``G`` shows it source images."""
    long = [e for e in episodes if len(e) >= SHORTEST_EPISODE][:FORECAST_EPISODES]
    short = [
        Episode(e.actions[:FORECAST_STEPS], {k: v[: FORECAST_STEPS + 1] for k, v in e.observations.items()})
        for e in long
    ]
    return tuple(ObservedStart(e.actions, compared(*sensor.motion(e, dt, G))) for e in short)


def image_forecaster(
    seen: tuple[ObservedStart, ...], sensor: ImageSensor, G: VisualTransformation, compared: ComparedChannels,
    make_env: Callable[[Domain, int], VectorImageEnv], dt: float,
) -> Forecaster:  # fmt: skip
    """Forecasts that are rendered, seen through G and read by the sensor.

    Args:
        seen: of the target.
        sensor: reads target images.
        G: shows source images as target images.
        compared: makes what is compared of motions.
        make_env: simulations of a domain with images, so many side by side.
        dt: control period, s.
    """

    def read(frames: np.ndarray, commands: np.ndarray) -> np.ndarray:
        states = np.zeros((len(frames), 1), np.float32)  # not looked at
        return compared(*sensor.motion(Episode(commands, {"pixels": frames, "state": states}), dt, G))

    def newest(obs: dict[str, np.ndarray]) -> np.ndarray:
        return obs["pixels"][:, -1]

    return Forecaster(seen, lambda domain: make_env(domain, ENSEMBLE), newest, read, spread([s.read for s in seen]))


def state_forecaster(
    seen: tuple[ObservedStart, ...], source: Domain, compared: ComparedChannels, noise: np.ndarray, dt: float, seed: int
) -> Forecaster:
    """Forecasts of positions alone, without images: quick, and what the sensor gets wrong is white noise to them.

    Args:
        seen: of the target.
        source: whose motions say how far joints move where the sensor hardly sees that they do: its bias would be
            large in units of what it reads, and drown all else.
        compared: makes what is compared of motions.
        noise: standard deviation of the sensor's errors of positions, (nv,).
        dt: control period, s.
        seed: of those errors.
    """
    n, noise = len(compared.dofs), noise[compared.dofs]
    positions = tuple(ObservedStart(s.commands, s.read[:, :n]) for s in seen)

    def read(states: np.ndarray, commands: np.ndarray) -> np.ndarray:
        exact = compared.positions(compared.task.motion(states.astype(float), dt)[0])
        return exact + noise * np.random.default_rng(seed).normal(size=exact.shape)

    def state(obs: dict[str, np.ndarray]) -> np.ndarray:
        return obs["state"]

    forecasts = Forecaster(
        positions,
        lambda d: VectorStateEnv(compared.task, d, ENSEMBLE),
        state,
        read,
        spread([s.read for s in positions]),
    )
    moves = spread([x.reshape(-1, n) for x in forecasts.ensembles(source, seed)])
    return replace(forecasts, scale=np.maximum(forecasts.scale, moves))


def spread(values: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation over all of (n, d) arrays, (d,)."""
    return np.concatenate(values).std(0) + 1e-9

"""How well a source with some effects tells beforehand what a sensor reads of the target.

The commands of the target's recordings are played in it from resets, several times over. What it looks like is seen
through G and read by the same sensor, so that what G and the sensor get wrong is on both sides of the comparison, and
windows need not begin with velocities that no image shows. Episodes must begin alike in both domains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from datamodules import Episode
from idapt_pl.effects import Domain
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.estimation.energy import energy_score
from idapt_pl.image_diagnosis.channels import ComparedChannels
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE
from idapt_pl.modules import VisualTransformation

ENSEMBLE_SIZE = 4
"""How often commands are played, each time from another reset."""

FORECAST_STEPS = 20
"""Control steps that are forecast: what follows says ever less, since contacts multiply what resets differ by."""

FORECAST_AFTER_PAIRS = 10
"""Of these at least so many after the steps that G learned as pairs: it shows there what the source would have done
(docs/decisions/059)."""

FORECAST_EPISODES = 12
"""Episodes that are forecast, at most."""

Observe = Callable[[dict[str, np.ndarray]], np.ndarray]
"""What is kept of the observations of simulations side by side, (members, ...)."""


@dataclass(frozen=True)
class ObservedStart:
    """The beginning of an episode as a sensor read it: commands (T, nu) and channels (T+1, d)."""

    commands: np.ndarray
    read: np.ndarray


@dataclass(frozen=True)
class Forecaster:
    """What was read of the target, and how to forecast it.

    Attributes:
        starts: of the target's episodes.
        make_env: simulations of a domain side by side, a member of an ensemble each.
        observe: what is kept of their observations.
        to_channels: from that of one member, (t+1, ...), and the commands (t, nu) that were played, to channels
            (t+1, d).
        scale: of the channels, (d,).
        begin: control steps that are played and not judged.
    """

    starts: tuple[ObservedStart, ...]
    make_env: Callable[[Domain], VectorImageEnv]
    observe: Observe
    to_channels: Callable[[np.ndarray, np.ndarray], np.ndarray]
    scale: np.ndarray
    begin: int = 0

    def ensembles(self, domain: Domain, seed: int, count: int | None = None) -> list[np.ndarray]:
        """What the first ``count`` starts were to be expected to look like in a domain, (members, T+1, d) each.

        Resets are those of the seed whatever the domain is.
        """
        with closing(self.make_env(domain)) as env:
            played = [play_commands(env, s.commands, seed + k, self.observe) for k, s in enumerate(self.starts[:count])]
        pairs = zip(self.starts, played, strict=False)
        return [
            np.stack([pad_with_last(self.to_channels(x, s.commands[: len(x) - 1]), len(s.read)) for x in members])
            for s, members in pairs
        ]

    def scores(self, domain: Domain, seed: int, count: int | None = None) -> np.ndarray:
        """Energy score of every start in a domain, (n,); less is better."""
        return self.scores_of(self.ensembles(domain, seed, count))

    def scores_of(self, expected: Sequence[np.ndarray]) -> np.ndarray:
        """Energy scores of :meth:`ensembles`, (n,)."""
        pairs = zip(expected, self.starts, strict=False)
        judged = ((x[:, self.begin :], s.read[self.begin :]) for x, s in pairs)
        return np.array([energy_score(x / self.scale, read / self.scale) for x, read in judged])

    def errors_of(self, expected: Sequence[np.ndarray]) -> np.ndarray:
        """Root mean square of what was read less the means of :meth:`ensembles`, of each channel, (d,)."""
        pairs = zip(expected, self.starts, strict=True)
        return np.sqrt(np.mean(np.concatenate([np.square(x.mean(0) - s.read)[self.begin + 1 :] for x, s in pairs]), 0))


def play_commands(env: VectorImageEnv, commands: np.ndarray, seed: int, observe: Observe) -> list[np.ndarray]:
    """What simulations show when commands (T, nu) are played from resets, (t+1, ...) each.

    Fewer than T+1 where an episode was over before.
    """
    obs, _ = env.reset(seed=seed)
    kept, running = [[x] for x in observe(obs)], np.ones(env.num_envs, bool)
    for command in commands:
        obs, _, terminations, truncations, infos = env.step(np.repeat(command[None], env.num_envs, 0))
        over = terminations | truncations
        newest = observe(infos["final_obs"] if over.any() else obs)
        for i in np.flatnonzero(running):
            kept[i].append(newest[i])
        running &= ~over
        if not running.any():
            break
    return [np.stack(x) for x in kept]


def pad_with_last(x: np.ndarray, length: int) -> np.ndarray:
    """A sequence made so long by its last row: what was over before stays as it was."""
    return np.concatenate([x, np.repeat(x[-1:], length - len(x), 0)])


def observed_starts(
    sensor: ImageSensor,
    episodes: Iterable[Episode],
    dt: float,
    compared: ComparedChannels,
    G: VisualTransformation | None = None,
    begin: int = 0,
) -> tuple[ObservedStart, ...]:
    """The beginnings of episodes that last long enough, as a sensor reads them; ``G`` shows it source images.

    ``begin`` control steps of each are not to be judged.
    """
    steps = max(FORECAST_STEPS, begin + FORECAST_AFTER_PAIRS)
    long = long_enough(episodes, begin)[:FORECAST_EPISODES]
    short = [Episode(e.actions[:steps], {k: v[: steps + 1] for k, v in e.observations.items()}) for e in long]
    return tuple(ObservedStart(e.actions, compared.motion(*sensor.motion(e, dt, G))) for e in short)


def long_enough(episodes: Iterable[Episode], begin: int = 0) -> list[Episode]:
    """Episodes of which enough is left to judge after so many control steps."""
    return [e for e in episodes if len(e) >= begin + SHORTEST_EPISODE]


def image_forecaster(
    starts: tuple[ObservedStart, ...], sensor: ImageSensor, G: VisualTransformation, compared: ComparedChannels,
    make_env: Callable[[Domain, int], VectorImageEnv], dt: float, begin: int = 0,
) -> Forecaster:  # fmt: skip
    """Forecasts that are rendered, seen through G and read by the sensor.

    Args:
        starts: of the target's episodes.
        sensor: reads target images.
        G: shows source images as target images.
        compared: makes channels of motions.
        make_env: simulations of a domain with images, so many side by side.
        dt: control period, s.
        begin: control steps that are not judged.
    """

    def read(frames: np.ndarray, commands: np.ndarray) -> np.ndarray:
        states = np.zeros((len(frames), 1), np.float32)  # not looked at
        return compared.motion(*sensor.motion(Episode(commands, {"pixels": frames, "state": states}), dt, G))

    def newest_frame(obs: dict[str, np.ndarray]) -> np.ndarray:
        return obs["pixels"][:, -1]

    scale = standard_deviation([s.read for s in starts])
    return Forecaster(starts, lambda domain: make_env(domain, ENSEMBLE_SIZE), newest_frame, read, scale, begin)


def state_forecaster(
    starts: tuple[ObservedStart, ...], source: Domain, compared: ComparedChannels, noise: np.ndarray, dt: float,
    seed: int, begin: int = 0,
) -> Forecaster:  # fmt: skip
    """Forecasts of positions alone, without images: quick, and what the sensor gets wrong is white noise to them.

    Args:
        starts: of the target's episodes.
        source: whose motions say how far joints move where the sensor hardly sees that they do: its bias would be
            large in units of what it reads, and drown all else.
        compared: makes channels of motions.
        noise: standard deviation of the sensor's errors of positions, (nv,).
        dt: control period, s.
        seed: of those errors.
        begin: control steps that are not judged.
    """
    n, noise = len(compared.dofs), noise[compared.dofs]
    positions = tuple(ObservedStart(s.commands, s.read[:, :n]) for s in starts)

    def read(states: np.ndarray, commands: np.ndarray) -> np.ndarray:
        exact = compared.positions(compared.task.motion(states.astype(float), dt)[0])
        return exact + noise * np.random.default_rng(seed).normal(size=exact.shape)

    def state(obs: dict[str, np.ndarray]) -> np.ndarray:
        return obs["state"]

    scale = standard_deviation([s.read for s in positions])
    forecasts = Forecaster(
        positions, lambda domain: VectorStateEnv(compared.task, domain, ENSEMBLE_SIZE), state, read, scale, begin
    )
    moves = standard_deviation([x.reshape(-1, n) for x in forecasts.ensembles(source, seed)])
    return replace(forecasts, scale=np.maximum(scale, moves))


def standard_deviation(values: Sequence[np.ndarray]) -> np.ndarray:
    """Over all rows of (n, d) arrays, (d,); never zero."""
    return np.concatenate(values).std(0) + 1e-9

"""Parameters of effects that were found, by how well simulations from known starts forecast what is read of images."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from datamodules import Episode, Trajectories
from datamodules.unpaired import read_all
from idapt_pl.effects import Effect
from idapt_pl.image_diagnosis.parabola import minimum_uncertainty, parabola_minimum
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.smoothing import ReadRecording, RecordingSmoother, reading_model
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.labels import known_starts, recordings_of
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)

ONE_BY_ONE = SideBySide(1)
"""Where a call makes use of all threads itself."""

SECONDS, STEPS_LEAST, STEPS_MOST = 0.5, 8, 40
"""How long recordings are followed from their start, within bounds in control steps.

Sooner the dynamics hardly tell; later a robot that moves otherwise than its source is where no estimator has been."""
SECONDS_AFTER_PAIRS, STEPS_AFTER_PAIRS = 0.3, 4
"""For how long they are followed at least once the steps are over that G learned as pairs, and how many control steps
of them a recording must have.

In pairs G learns to show what the source did as what the target did after the same actions. So in these steps the
encoder reads what the source would have done, whatever is missing (docs/decisions/059)."""
RECORDINGS_LEAST = 8
"""That last beyond the pairs; with fewer all are judged from their beginning."""
SMALLEST_SCALE = 1e-3
"""Of a component, in units of its spread: what could be read better would not say more."""
READING_ERROR = 6.0
"""Times the error on translated images that readings are taken to have: so that they hardly move a simulation."""
STRIDES = (0.2, 0.08)
"""Of the logarithm of a parameter, in a first and a second round of five values."""

Misfits = Callable[[Sequence[Effect]], np.ndarray]
"""Effects to how badly every recording is forecast with them, (n,): nats, as of :func:`misfits`."""


@dataclass(frozen=True)
class Refined:
    """An effect's parameter after refinement; ``log_halfwidth``: half of a 95 % interval of its logarithm, None from
    a single recording.
    """

    effect: str
    target: str
    parameter: str
    before: float
    after: float
    log_halfwidth: float | None


@dataclass(frozen=True)
class KnownStartForecasts:
    """How badly forecasts from known starts fit what is read, positions alone.

    Attributes:
        smooth: ensembles of the source that readings hardly correct.
        recordings: as a sensor reads them.
        begin: control steps of each that are not judged.
        steps: of each, from its start.
        shown: components of the state that positions depend on.
        scale: their spread.
        seed: of the ensembles.
    """

    smooth: RecordingSmoother
    recordings: Sequence[ReadRecording]
    begin: int
    steps: int
    shown: Sequence[int]
    scale: np.ndarray
    seed: int

    def __call__(self, effects: Sequence[Effect]) -> np.ndarray:
        """Misfits (n,) of the forecasts of every recording by the source with these effects."""
        domain = self.smooth.domain.with_effects(*effects)
        made = replace(self.smooth, domain=domain)([r.first(self.steps) for r in self.recordings], self.seed)
        return misfits([s.surprise[1 + self.begin :, self.shown] / self.scale for s in made])

    def first(self, recordings: int) -> KnownStartForecasts:
        """Of so many recordings."""
        return replace(self, recordings=self.recordings[:recordings])

    def roughly(self, members: int) -> KnownStartForecasts:
        """With so many simulations that follow each recording, and longer physics steps where these do."""
        return replace(self, smooth=replace(self.smooth, members=members, roughly=True))

    def beyond(self, recordings: int) -> KnownStartForecasts:
        """Of those after so many."""
        return replace(self, recordings=self.recordings[recordings:])


def known_start_forecasts(
    c: StageContext, target: Sequence[Path], control: Path, G: VisualTransformation, pi: AsymmetricSAC, seed: int,
    most: int, members: int, paired_steps: int = 0,
) -> tuple[KnownStartForecasts, KnownStartForecasts]:  # fmt: skip
    """Forecasts of the first frames of the target, and of the control through G, where the source lacks nothing.

    Args:
        c: of the run.
        target: trajectory files, of which images and actions are used.
        control: trajectory file of the source, images and states, that nothing was fitted to.
        G: shows source images as target images.
        pi: its encoder reads target images.
        seed: of the ensembles.
        most: recordings of each.
        members: simulations that follow each.
        paired_steps: control steps from where episodes begin that G learned as pairs.
    """
    worlds, sensor = c.worlds, pi.estimator(G)
    source, seen = read_all([control], also="state"), read_all(target)
    begin = paired_steps if min(len(lasting(d, paired_steps)) for d in (source, seen)) >= RECORDINGS_LEAST else 0
    if begin < paired_steps:
        log.warning(
            "recordings are over with the %d steps that G learned as pairs: effects come out small", paired_steps
        )
    kept, watched = (lasting(d, begin)[:most] for d in (source, seen))
    known = replace(source, episodes=tuple(G.translate_episode(e) for e in kept))
    states = np.concatenate([e.observations["state"] for e in known])
    read = recordings_of(known, sensor, worlds.frame_stack)
    readings = np.concatenate([r.readings for r in read])
    expected = reading_model(worlds.task, worlds.source_domain, readings, states).times(READING_ERROR)
    first = recordings_of(replace(seen, episodes=tuple(watched)), sensor, worlds.frame_stack)
    smooth = RecordingSmoother(
        worlds.task, worlds.source_domain, expected, members, 0, torch.get_num_threads(), known_starts(worlds)
    )
    shown = position_components(worlds.task, states[0].astype(float))
    scale = states.std(0)[shown] + 1e-9
    steps = int(np.clip(round(SECONDS / worlds.period), STEPS_LEAST, STEPS_MOST))
    if begin:
        steps = max(steps, begin + max(STEPS_AFTER_PAIRS, round(SECONDS_AFTER_PAIRS / worlds.period)))
    of_target, of_control = (
        KnownStartForecasts(smooth, recordings, begin, steps, shown, scale, seed) for recordings in (first, read)
    )
    return of_target, of_control


def lasting(data: Trajectories, begin: int) -> list[Episode]:
    """Episodes of which some steps are left after the first so many."""
    return [e for e in data.episodes if len(e) >= (begin + STEPS_AFTER_PAIRS if begin else 1)]


def misfits(surprises: Sequence[np.ndarray]) -> np.ndarray:
    """Mean negative logarithm of the likelihood of every recording's surprises (T, c), (n,), nats.

    As if they had Laplace's distribution, with a median and a scale for each component that are those of the surprises:
    what is read badly whatever the dynamics then weighs little, and a sensor that is off by something constant does not
    draw parameters to where the robot is off by as much. The mean of all is the logarithm of :func:`mean_error`.
    """
    every = np.concatenate(surprises)
    common = np.median(every, 0)
    scale = np.abs(every - common).mean(0) + SMALLEST_SCALE
    return np.array([(np.abs(s - common).mean(0) / scale + np.log(scale)).mean() - 1 for s in surprises])


def mean_error(of_recordings: np.ndarray) -> float:
    """The geometric mean over components of the error of forecasts, in units of their spread, from misfits (n,)."""
    return float(np.exp(of_recordings.mean()))


def position_components(task: Task, state: np.ndarray) -> list[int]:
    """Which components of a state (s,) positions depend on."""
    at = task.motion(state[None], 1.0)[0]
    moved = (task.motion((state + step)[None], 1.0)[0] for step in 1e-3 * np.eye(len(state)))
    return [i for i, qpos in enumerate(moved) if not np.allclose(qpos, at, atol=1e-9)]


def refine_parameters(
    effects: Sequence[Effect], misfit: Misfits, side_by_side: SideBySide = ONE_BY_ONE
) -> tuple[list[Effect], list[Refined]]:
    """One parameter after the other is put where a parabola through the misfits at five values of it is lowest."""
    now, how = list(effects), []
    for i, name in scalars(effects):
        before, spread = getattr(now[i], name), None
        for stride in STRIDES:
            x = stride * np.arange(-2, 3)
            tried = [scaled(now[i], name, float(np.exp(u))) for u in x]
            scores = np.array(side_by_side.map(misfit, [[*now[:i], e, *now[i + 1 :]] for e in tried]))
            x = np.log([getattr(e, name) / getattr(now[i], name) for e in tried])  # some are at a bound
            best, _ = parabola_minimum(x, scores.mean(1))
            spread = minimum_uncertainty(x, scores) if len(scores[0]) > 1 else None
            now[i] = scaled(now[i], name, float(np.exp(best)))
        how.append(Refined(now[i].name, now[i].target, name, before, getattr(now[i], name), spread))
    return now, how


def scalars(effects: Sequence[Effect]) -> list[tuple[int, str]]:
    """Which effect, and which of its parameters, that are single numbers other than 0."""
    return [
        (i, f.name)
        for i, e in enumerate(effects)
        for f in dataclasses.fields(e)
        if "unit" in f.metadata and isinstance(value := getattr(e, f.name), float | int) and value
    ]


def scaled(effect: Effect, name: str, factor: float) -> Effect:
    """With a parameter that is so many times as large, within its bounds, to six digits."""
    bounds = next(f.metadata for f in dataclasses.fields(effect) if f.name == name)
    value = np.clip(getattr(effect, name) * factor, bounds["low"], bounds["high"])
    changed: dict[str, Any] = {name: float(f"{value:.6g}")}
    return replace(effect, **changed)

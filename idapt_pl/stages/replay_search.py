"""Which effects a source lacks whose states tell no positions: by replays of the target's actions from known starts.

Where states tell positions, simulations can be put anywhere (:mod:`~idapt_pl.stages.known_start_search`). Where they
do not, as with an arm whose state is where its hand is, the beginning of an episode is the one place that is known.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from datamodules.unpaired import read_all
from idapt_pl.diagnosis.candidates.listing import all_candidates, typical_sizes
from idapt_pl.diagnosis.prepare import choose_candidates
from idapt_pl.effects import Domain, Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.envs import VectorStateEnv
from idapt_pl.image_diagnosis.forecast_diagnosis import of_one_parameter
from idapt_pl.image_diagnosis.forecast_search import first_values
from idapt_pl.image_diagnosis.forecasts import FORECAST_STEPS
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.prediction.data import Recording
from idapt_pl.prediction.side_by_side import SideBySide
from idapt_pl.smoothing import ReadRecording
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.known_start_search import JUDGED, TOLD, KnownStartSearch, gain_of
from idapt_pl.stages.labels import known_starts, recordings_of
from idapt_pl.stages.refinement import STEPS_AFTER_PAIRS, Misfits, Refined, mean_error, misfits, refine_parameters
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)

REPLAYED, REPLAYED_STEPS = 80, 40
"""Recordings that are replayed, and control steps of each at most."""
SCREENED_BY = 12
"""Of these, as many at least as all candidates are tried with first; those that did best are judged by all."""
SIZED = 8
"""Recordings whose actions are played in the source to see how fast and how far things move."""
FARTHER = (3, 10)
"""Multiples of a noticeable change that are tried too: where a command is small, what is added to it may be large."""
STARTS_ALIKE = 0.1
"""Share of a component's spread that it may have where episodes begin, and be known there."""


@dataclass(frozen=True)
class Replays:
    """How far replays of recorded actions, from where episodes begin, are from what was read of the images.

    Attributes:
        task: of the robot.
        domain: its source.
        recordings: as a sensor reads them, all of as many control steps.
        shown: components of the state that are known where episodes begin, and change.
        scale: their spread.
        begin: control steps from where episodes begin that are not judged.
    """

    task: Task
    domain: Domain
    recordings: Sequence[ReadRecording]
    shown: Sequence[int]
    scale: np.ndarray
    begin: int = 0

    def __call__(self, effects: Sequence[Effect]) -> np.ndarray:
        """Misfits (n,) of the replays of every recording in the source with these effects."""
        lasted, simulated = self.simulated(effects)
        return misfits(
            [
                ((r.readings[1 : n + 1][:, self.shown] - s[:n]) / self.scale)[min(self.begin, n - 1) :]
                for r, s, n in zip(self.recordings, simulated, lasted, strict=True)
            ]
        )

    def few(self) -> Replays:
        """Of every so many recordings, as candidates are tried with."""
        return replace(self, recordings=self.recordings[:: max(1, len(self.recordings) // SCREENED_BY)])

    def simulated(self, effects: Sequence[Effect] = ()) -> tuple[np.ndarray, np.ndarray]:
        """How many steps each replay lasted, (n,), and what was shown after each of them, (n, T, c)."""
        actions = np.stack([r.actions for r in self.recordings], 1)  # (T, n, nu)
        lasted, states = np.full(len(self.recordings), len(actions)), []
        with closing(VectorStateEnv(self.task, self.domain.with_effects(*effects), len(self.recordings))) as env:
            env.reset(seed=0)
            for t, played in enumerate(actions):
                obs, _, terminations, truncations, infos = env.step(played)
                ended = terminations | truncations
                lasted[ended] = np.minimum(lasted[ended], t + 1)
                states.append(infos["final_obs"]["state"] if ended.any() else obs["state"])
        return lasted, np.stack(states, 1)[..., self.shown]


def effects_from_replays(
    c: StageContext, step: int, settings: DiscoverySettings, target: Sequence[Path], control: Path,
    G: VisualTransformation, pi: AsymmetricSAC, paired_steps: int = 0,
) -> list[dict]:  # fmt: skip
    """The effects to add, as they are written; ``known_start_search.json`` says why these.

    Args:
        c: of the run.
        step: grounding step.
        settings: which effects are considered, and how many looked for.
        target: trajectory files, of which images and actions are used.
        control: trajectory file of the source, images and states, that nothing was fitted to.
        G: shows source images as target images.
        pi: its encoder reads target images.
        paired_steps: control steps from where episodes begin that G learned as pairs; they are not judged.
    """

    def make(seed: int) -> dict:
        source = read_all([control], also="state")
        known = replace(source, episodes=tuple(G.translate_episode(e) for e in source.episodes[:REPLAYED]))
        states = np.concatenate([e.observations["state"] for e in known])
        shown, scale = known_components(known_starts(c.worlds), states)
        seen = read_all(target)
        spread = np.unique(np.linspace(0, len(seen.episodes) - 1, REPLAYED).astype(int))  # of the newest files too
        seen = replace(seen, episodes=tuple(seen.episodes[i] for i in spread))
        task, domain = c.worlds.task, c.worlds.source_domain
        if not shown:
            log.warning("step %d  nothing of %s is known where episodes begin: no effects are sought", step, task.name)
            return KnownStartSearch(([], []), False, 0.0, 0.0, (0.0, 0.0, 0.0), ()).to_dict()
        read = [of_one_length(recordings_of(d, pi.estimator(G), c.worlds.frame_stack)) for d in (seen, known)]
        begin = paired_steps if min(len(r) for d in read for r in d) >= paired_steps + STEPS_AFTER_PAIRS else 0
        of_target, of_control = (Replays(task, domain, d, shown, scale, begin) for d in read)
        moved = played_in_source(task, domain, of_target.recordings[:SIZED])
        sizes = typical_sizes(domain.compile(), moved, FORECAST_STEPS * seen.dt)
        every = choose_candidates(all_candidates(domain.spec(), sizes), settings.candidates)
        sought = of_one_parameter(every), of_target, of_control, settings.max_effects
        return search_by_replays(*sought, SideBySide(torch.get_num_threads())).to_dict()

    return c.stages.measure(step, "known_start_search", make)["effects"]


def search_by_replays(
    candidates: Sequence[Candidate], of_target: Replays, of_control: Replays, most: int, side_by_side: SideBySide
) -> KnownStartSearch:
    """Effects, one after the other, with each of which replays of the target are surely closer, and the control's not.

    Args:
        candidates: effects of one parameter.
        of_target: replays of the target's actions.
        of_control: of the source's own, seen through G.
        most: effects that are taken.
        side_by_side: replays with one set of effects are a thread's; what is found does not depend on it.
    """
    without = of_target([])
    now: list[Effect] = []
    how: list[Refined] = []
    told: tuple[tuple[str, float, float], ...] = ()
    misfit, gain = without, (0.0, 0.0, 0.0)
    for _ in range(most):
        tried = signed_screening(candidates, now, of_target.few(), side_by_side)
        told = told or tuple((c.label, x, error) for c, x, error in tried[:TOLD])
        begun = [[*now, c.effect([x])] for c, x, _ in tried[:JUDGED]]
        if not begun:
            break
        its_misfit, (effects, refined) = min(
            ((of_target(rival[0]), rival) for rival in (refine_parameters(e, of_target, side_by_side) for e in begun)),
            key=lambda scored: scored[0].mean(),
        )
        its_gain, clear = gain_of(effects[-1:], misfit, its_misfit, of_control)
        if not clear:
            if not now:
                return KnownStartSearch(
                    (effects, refined), False, mean_error(without), mean_error(its_misfit), its_gain, told
                )
            break
        now, how, misfit, gain = effects, refined, its_misfit, its_gain
    return KnownStartSearch((now, how), bool(now), mean_error(without), mean_error(misfit), gain, told)


def signed_screening(
    candidates: Sequence[Candidate], now: Sequence[Effect], misfit: Misfits, side_by_side: SideBySide
) -> list[tuple[Candidate, float, float]]:
    """Candidates beside the effects so far, each with the value that fits best and the error then, the best first."""
    every = [(k, x) for k, c in enumerate(candidates) for x in values_tried(c)]
    effects = [list(now), *([*now, candidates[k].effect([x])] for k, x in every)]
    least, *errors = side_by_side.map(lambda e: mean_error(misfit(e)), effects)
    best: dict[int, tuple[float, float]] = {}
    for (k, x), error in zip(every, errors, strict=True):
        best[k] = min(best.get(k, (least, 0.0)), (error, x))
    better = [(candidates[k], x, error) for k, (error, x) in best.items() if error < least]
    return sorted(better, key=lambda found: found[2])


def values_tried(c: Candidate) -> list[float]:
    """Of a candidate's parameter, in both directions as far as it goes in both."""
    (low,), (high,) = c.bounds()
    ahead = [*first_values(c), *(x for (x,) in c.starts), *(f * c.scale[0] for f in FARTHER)]
    return sorted({sign * x for x in ahead for sign in (1, -1) if low < sign * x <= high})


def known_components(starts: np.ndarray, states: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Components of a state that are known where episodes begin, and change later; and their spread.

    Args:
        starts: states that episodes begin in, (k, s).
        states: of whole episodes, (n, s).
    """
    spread = states.std(0)
    shown = [i for i, s in enumerate(spread) if s > 1e-6 and starts[:, i].std() < STARTS_ALIKE * s]
    return shown, spread[shown]


def of_one_length(recordings: Sequence[ReadRecording]) -> list[ReadRecording]:
    """The first steps of recordings, as many of each: of those that are about as long as most, or longer."""
    steps = min(REPLAYED_STEPS, int(np.median([len(r) for r in recordings])))
    return [r.first(steps) for r in recordings if len(r) >= steps]


def played_in_source(task: Task, source: Domain, recordings: Sequence[ReadRecording]) -> list[Recording]:
    """What the source itself does from where episodes begin, for the actions of recordings of one length."""
    actions = np.stack([r.actions for r in recordings], 1)  # (T, n, nu)
    qpos, qvel = [], []
    with closing(VectorStateEnv(task, source, len(recordings))) as env:
        env.reset(seed=0)
        for played in (*actions, None):
            qpos.append([d.qpos.copy() for d in env.data])
            qvel.append([d.qvel.copy() for d in env.data])
            if played is not None:
                env.step(played)
        time = env.dt * np.arange(len(qpos))
    moved = zip(np.stack(qpos, 1), np.stack(qvel, 1), recordings, strict=True)
    return [Recording(f"episode_{i}", time, q, v, r.actions) for i, (q, v, r) in enumerate(moved)]

"""States for real images of the target, by the repaired source's physics: nothing of the target's own is known."""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from datamodules import Episode, Trajectories, read_trajectories
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.image_diagnosis.calibration import sub_episode, true_runs
from idapt_pl.image_diagnosis.sensor import estimate_states
from idapt_pl.modules import ActionTransformation, AsymmetricSAC, VisualTransformation
from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.smoothing import (
    ReadRecording,
    RecordingSmoother,
    Smoothed,
    most_that_is_bearable,
    reading_model,
    reading_offsets,
)
from idapt_pl.stage import stage_seed
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.cut_episodes import WHERE_LOST, to_be_cut
from idapt_pl.stages.encoder import translated
from idapt_pl.stages.replay_agreement import warn_if_read_otherwise
from idapt_pl.stages.replayed_labels import replayed_labels
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)

STARTS = 32
"""Of the source, which stand for those of the target."""

KNOWN_STEPS, KNOWN_STEPS_EACH = 400, 200
"""Control steps, and of each episode, of images whose states are known, by which the weight of readings is chosen."""

STARTS_WELL = 5
"""Control steps, at least, in which half of the recordings are not lost, where they are said to begin well."""


def labelled_images(
    c: StageContext, step: int, source: Sequence[Path], target: Sequence[Path], G: VisualTransformation,
    F: ActionTransformation | None, pi: AsymmetricSAC, paired_steps: int = 0, prefix: str = "",
) -> list[Path]:  # fmt: skip
    """Trajectory files with target-like images and states, for what reads them beside the policy's own experience.

    The first has source images through G. The others have the target's own: by physics where a teacher acts on
    estimates, by replays elsewhere. Without labels there are none, as nothing learns from them.

    Args:
        c: of the run.
        step: grounding step.
        source: trajectory files with images and states.
        target: trajectory files with images.
        G: shows source images as target images.
        F: what the source plays for an action of the target; None is the identity.
        pi: its encoder reads target images.
        paired_steps: control steps from where episodes begin that G learned as pairs.
        prefix: of the name of the file with source images through G.
    """
    name = f"{prefix}translated"
    if not c.teacher.settings.rehearse:
        told = replayed_labels(c, step, target, G, F)
        for path in told if pi.supervised else ():
            warn_if_read_otherwise(c, step, path, pi)
        return [translated(c, step, source, G, name), *told] if told else []
    known = translated(c, step, source, G, name)
    return [known, *label_target(c, step, target, known, G, F, pi, paired_steps)]


def label_target(
    c: StageContext, step: int, target: Sequence[Path], known: Path, G: VisualTransformation,
    F: ActionTransformation | None, pi: AsymmetricSAC, paired_steps: int = 0,
) -> list[Path]:  # fmt: skip
    """``labelled.h5``: the target's recordings with the states that readings and physics agree on; none if it is off.

    Readings of single images are off in ways that no source image shows. But the same actions, played in the source,
    say which of the states that are read can follow one another (:mod:`idapt_pl.smoothing`). With ``labels.offsets``
    they first say what is read wrong throughout (:mod:`idapt_pl.smoothing.offsets`).

    Args:
        c: of the run.
        step: grounding step.
        target: trajectory files, of which images and actions are used.
        known: trajectory file with target-like images whose states are known; says how wrong readings are at least.
        G: shows source images as target images.
        F: what the source plays for an action of the target; None is the identity.
        pi: its encoder reads target images.
        paired_steps: control steps from where episodes begin that G learned as pairs: there the sensor reads what the
            source would do, so no offset is sought or taken away.
    """
    if not c.labels.members:
        return []
    sensor = pi.estimator(G)

    @functools.cache
    def prepared() -> tuple[Trajectories, RecordingSmoother, list[ReadRecording], np.ndarray]:
        torch.manual_seed(step)  # F samples; whether this is the first or a resumed process must make no difference
        data = read_all(target)
        return data, *smoother_of(c, data, known, sensor, F)

    def offsets(seed: int) -> dict:
        return offsets_of_files(target, *prepared()[1:], paired_steps)

    @functools.cache
    def corrected() -> tuple[Trajectories, RecordingSmoother, list[ReadRecording], np.ndarray]:
        data, smooth, recordings, scale = prepared()
        pairs = zip(recordings, found, strict=True) if found else ()
        return data, smooth, [r.without(np.array(o), paired_steps) for r, o in pairs] or recordings, scale

    def factors(seed: int) -> dict:
        _, smooth, _, scale = prepared()
        return reading_error_factor(c, smooth, sensor, G, scale, seed)

    @functools.cache
    def smoothed() -> tuple[Trajectories, list[Smoothed], Trajectories]:
        data, smooth, recordings, _ = corrected()
        found = smooth.supposing(factor)(recordings, stage_seed(c.stages.seed, step, "labelled"))
        return data, found, labelled(data, found, c.labels.lag)

    told = c.stages.measure(step, "reading_offsets", offsets)["files"] if c.labels.offsets else ()
    found = [file["offset"] for file in told for _ in range(file["episodes"])]
    factor = c.stages.measure(step, "reading_errors", factors)["factor"]
    if not (c.stages.folder(step) / "labelled.h5").exists():  # runs of earlier versions have that alone
        warn_of_losses(c, step, c.stages.measure(step, WHERE_LOST, lambda seed: losses(*smoothed())))
    return [c.stages.record(step, "labelled", lambda seed: smoothed()[-1])[0]]


def reading_error_factor(
    c: StageContext, smooth: RecordingSmoother, sensor: PixelStatePredictor, G: VisualTransformation, scale: np.ndarray,
    seed: int,
) -> dict:  # fmt: skip
    """How wrong readings of the target are taken to be, as ``reading_errors.json`` has it.

    Judged where states are known: by the control that was recorded of the plain source, or what G learned from where
    there is none (docs/decisions/079).

    Args:
        c: of the run.
        smooth: expects readings as wrong as on images that encoder and G learned from.
        sensor: reads target images.
        G: shows source images as target images.
        scale: spread of every component of a state, (s,).
        seed: of the ensembles.
    """
    control, learned_from = (c.stages.folder(0) / f"{name}.h5" for name in ("control", "source"))
    data = read_all([control if control.exists() else learned_from], also="state")
    shown = replace(data, episodes=tuple(map(G.translate_episode, first_episodes(data))))
    recordings = recordings_of(shown, sensor, c.worlds.frame_stack)
    states = [e.observations["state"] for e in shown]
    errors = replace(smooth, domain=c.worlds.first_source).state_errors(recordings, states, scale, seed)
    return {"factor": most_that_is_bearable(errors), "state_errors": list(errors.items())}


def first_episodes(data: Trajectories) -> list[Episode]:
    """The beginnings of as many episodes as make up :data:`KNOWN_STEPS`."""
    kept: list[Episode] = []
    for episode in data:
        if sum(map(len, kept)) >= KNOWN_STEPS:
            break
        kept.append(episode.part(0, min(len(episode), KNOWN_STEPS_EACH)))
    return kept


def offsets_of_files(
    target: Sequence[Path],
    smooth: RecordingSmoother,
    recordings: Sequence[ReadRecording],
    scale: np.ndarray,
    begin: int,
) -> dict:
    """What is read too much throughout each file, as ``reading_offsets.json`` has it: each policy has its own poses.

    Args:
        target: trajectory files.
        smooth: has the source's physics.
        recordings: all of them, as a sensor reads them, in order.
        scale: spread of every component of a state, (s,).
        begin: control steps of each recording that are not looked at.
    """
    found, ahead = [], list(recordings)
    for path in target:
        count = len(read_trajectories(path).episodes)
        mine, ahead = ahead[:count], ahead[count:]
        offset, (gain, error) = reading_offsets(smooth.task, smooth.domain, mine, scale, begin)
        told = np.array2string(offset / scale, precision=2, suppress_small=True, max_line_width=1000)
        log.info("%s  offsets of readings, in spreads: %s (gain %.2g ± %.2g)", path.parent.name, told, gain, error)
        spread = error if np.isfinite(error) else None  # fewer than half of the recordings gain; JSON has no infinity
        found.append({"episodes": count, "offset": offset.tolist(), "gain": gain, "standard_error": spread})
    return {"files": found, "spreads": scale.tolist()}


def smoother_of(
    c: StageContext, target: Trajectories, known: Path, sensor: PixelStatePredictor, F: ActionTransformation | None
) -> tuple[RecordingSmoother, list[ReadRecording], np.ndarray]:
    """A smoother that takes readings to be as wrong as on ``known``, what is read of the target, and states' spread."""
    images = read_all([known], also="state")
    read = np.concatenate([r.readings for r in recordings_of(images, sensor, c.worlds.frame_stack)])
    states = np.concatenate([e.observations["state"] for e in images])
    task, domain = c.worlds.task, c.worlds.source_domain
    expected = reading_model(task, domain, read, states)
    threads, starts = torch.get_num_threads(), known_starts(c.worlds) if c.labels.known_start else None
    smooth = RecordingSmoother(task, domain, expected, c.labels.members, c.labels.lag, threads, starts)
    return smooth, recordings_of(target, sensor, c.worlds.frame_stack, F), states.std(0) + 1e-9


def known_starts(worlds: Worlds) -> np.ndarray:
    """States that episodes of the source begin in, (k, s)."""
    with closing(worlds.source_states(STARTS)) as env:
        return env.reset(seed=0)[0]["state"].astype(float)


def recordings_of(
    data: Trajectories, sensor: PixelStatePredictor, frame_stack: int, F: ActionTransformation | None = None
) -> list[ReadRecording]:
    """Recordings as a sensor reads them, with what the source plays for their actions."""
    recordings = []
    for episode in data:
        images, actions = FrameStacks([episode], frame_stack), episode.actions
        if F is not None:
            actions = F.transform(images.stacks(np.arange(len(episode))), actions)
        recordings.append(ReadRecording(estimate_states(images, sensor), actions.astype(float)))
    return recordings


def labelled(data: Trajectories, smoothed: Sequence[Smoothed], lag: int) -> Trajectories:
    """Recordings with smoothed states, without what is near where it was lost."""
    kept: list[Episode] = []
    for episode, found in zip(data, smoothed, strict=True):
        unsure = np.convolve(found.lost, np.ones(2 * lag + 1))[lag : lag + len(found.lost)] > 0.5
        states = {"state": found.states.astype(np.float32), "pixels": episode.observations["pixels"]}
        whole = Episode(episode.actions, states)
        kept += [sub_episode(whole, *run) for run in true_runs(~unsure)]
    return replace(data, episodes=tuple(kept), source=f"{data.source}, states by smoothing")


def losses(data: Trajectories, smoothed: Sequence[Smoothed], kept: Trajectories) -> dict:
    """How much of recordings was lost, as ``lost.json`` has it; from which control step on, where most begin well."""
    frames, labels = (t.total_steps + len(t) for t in (data, kept))
    times = sum(int(s.lost.sum()) for s in smoothed)
    log.info("%d of %d target frames labelled; the state was lost %d times", labels, frames, times)
    often = labels < frames / 2
    return {"frames": frames, "labelled": labels, "from": lost_from([s.lost for s in smoothed]) if often else None}


def lost_from(lost: Sequence[np.ndarray]) -> int | None:
    """The control step from which on recordings, bool (T+1,) each, are lost if most are, and begin well; else None."""
    first = [int(np.argmax(steps)) for steps in lost if steps.any()]
    begin = int(np.median(first)) if first else 0
    return None if len(first) < len(lost) / 2 or begin < STARTS_WELL else begin


def warn_of_losses(c: StageContext, step: int, told: dict) -> None:
    """Say what to look at where most frames were lost, and nothing is done about it."""
    begin = told["from"]
    if told["labelled"] >= told["frames"] / 2 or (begin is not None and to_be_cut(c, step)):
        return
    log.warning(
        "the source's physics and what is read of the target's images often disagree: look at translated.h5 and at "
        "the effects found, as G or the source is off%s",
        "" if begin is None else f". Most episodes begin well and are lost from about control step {begin} on: look "
        "there at target.h5, whether the robot has fallen or left the picture",
    )  # fmt: skip

"""Which physical effect does the source lack? Found from the target's images and actions alone.

An estimator of the state, fitted to what G shows of the source, turns the target's images into positions and
velocities. Where it cannot tell how fast things move, effects are judged by how well the source with them forecasts
what it reads (:mod:`idapt_pl.forecast_search`). Else the diagnosis looks for the effect with which the source replays
it. It is a poor sensor, with errors that depend on the
state, so the same diagnosis is made a second time on recordings of the source, seen through G: there nothing is
missing, and what is found is an error of the sensor. What is found in the target is believed if the error there is
clearly larger and most of the difference goes with it, or if a good share of the error goes with it and none such in
the control; and if it is something else, or far more of the same. Of several effects each must say so for itself, of
what is left when it is left out.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from datamodules import Trajectories
from datamodules.unpaired import read_all
from idapt_pl.diagnosis import Diagnosis, diagnose
from idapt_pl.diagnosis.data import recordings
from idapt_pl.diagnosis.library import library, surroundings
from idapt_pl.diagnosis.search import Settings, choose
from idapt_pl.domains import Domain
from idapt_pl.envs import VectorImageEnv
from idapt_pl.forecast_search import rounded, search, told
from idapt_pl.forecasts import STEPS, Compared, by_images, by_states, sightings
from idapt_pl.modules import VisualTransformation
from idapt_pl.sensing import GAIN, Calibration, Readings, Sensor, cut, read_calibrated
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
SHORTEST = 6
"""Control steps that an episode must last to be of use."""
BELIEVED = ((3.0, 0.5), (2.0, 0.9))
"""How many times as large as in the control the error must be in some channel of the target, and what share of what is
beyond the control's error there must go with what is found; either pair will do.

The sensor was fitted to images like the control's, so it errs more on the target even where nothing is missing: 1.0 to
1.8 times on the pendulum (``benchmarks/discovery.py --cases nothing``), 2.0 to 7.7 times on HalfCheetah."""
REMOVED = 0.3
"""Or the share of the whole error that must go with what is found, if it is also twice what goes in the control.

Motions in the target can be calmer than those of the control, and easier to read: then no channel's error is larger
than the control's, whatever is missing. Where nothing was missing up to 0.09 of it went on the pendulum, none on
HalfCheetah, and 0.33 on Walker2d, by velocities that its sensor could not read (``results/discovery.csv``, before and
after); 0.13 now."""
CANDIDATES = ("body_mass", "joint_damping", "joint_frictionloss", "joint_armature", "actuator_gain", "actuator_delay")
"""What is looked for by default: what an environment can be given, and what so poor a sensor can tell apart."""


@dataclass(frozen=True)
class Discovery:
    """Whether and how the loop looks for effects that the source lacks.

    Args:
        discover: look for them in every grounding step and add what is found to the source.
        candidates: names of the effects to consider.
        max_effects: stop after so many in a grounding step.
        looks: before anything is learned, look for visual effects (camera, lamps, colours, sky, blur) in the first
            frames of the target's episodes, and add what is found to the source. Episodes must begin alike in both.
    """

    discover: bool = False
    candidates: tuple[str, ...] = CANDIDATES
    max_effects: int = 2
    looks: bool = False


def pieces(data: Trajectories, length: int) -> Trajectories:
    """Episodes cut into pieces of ``length`` control steps; what is left over at an end is dropped."""
    parts = (cut(e, i, i + length + 1) for e in data for i in range(0, len(e) - length + 1, length))
    return Trajectories(tuple(parts), data.dt, data.source)


def beyond_the_control(target: dict[str, dict], control: dict[str, dict]) -> tuple[float, float]:
    """In the channel where the target's error exceeds the control's most: by what factor, and what share was removed.

    Args:
        target: channel to its errors ``before`` and ``after``, in its unit.
        control: the same, where nothing is missing.
    """
    ratios = {name: c["before"] / control[name]["before"] for name, c in target.items()}
    worst = max(ratios, key=ratios.get)
    beyond = target[worst]["before"] - control[worst]["before"]
    removed = target[worst]["before"] - target[worst]["after"]
    return ratios[worst], removed / beyond if beyond > 0 else 0.0


def removed(error: dict) -> float:
    """The share of the error, as in report.json, that goes with all that was found."""
    return 1.0 - error["after"] / error["before"] if error["before"] else 0.0


def believable(excess: float, explained: float, gone: float, made_up_share: float) -> bool:
    """Whether errors say that something is missing in the target, not only in what the sensor reads.

    Args:
        excess: as of :func:`beyond_the_control`.
        explained: the same.
        gone: :func:`removed` in the target.
        made_up_share: and in the control.
    """
    beyond = any(excess > more and explained > share for more, share in BELIEVED)
    return beyond or gone > max(REMOVED, 2 * made_up_share)


def adds(fewer: dict, seen: dict, control: dict) -> bool:
    """Whether one effect more is worth it: errors with it against those with the ones before it.

    Args:
        fewer: ``error`` of report.json without it.
        seen: with it.
        control: that of the control.
    """
    left = {name: {"before": e["after"], "after": seen["per_channel"][name]["after"]}
            for name, e in fewer["per_channel"].items()}  # fmt: skip
    gone = 1.0 - (1.0 - removed(seen)) / max(1.0 - removed(fewer), 1e-12)
    return believable(*beyond_the_control(left, control["per_channel"]), gone, removed(control))


def worth_it(diagnosed: Callable[[int], Diagnosis], most: int, control: Diagnosis) -> tuple[Diagnosis, list[dict]]:
    """The diagnosis with at most so many effects, less the last ones found that do not say enough for themselves.

    A sensor errs on the target, and the effect that is there seldom accounts for all of what it reads: the next one
    found then makes up for the sensor.

    Args:
        diagnosed: the target's diagnosis with at most so many effects.
        most: that are looked for.
        control: the control's.

    Returns:
        It, and the effects left out, as in report.json.
    """
    seen, left_out = diagnosed(most), []
    while (found := len(seen.report["effects"])) > 1:
        fewer = diagnosed(found - 1)
        if adds(fewer.report["error"], seen.report["error"], control.report["error"]):
            break
        kept = [(e["effect"], e["target"]) for e in fewer.report["effects"]]
        left_out += [e for e in seen.report["effects"] if (e["effect"], e["target"]) not in kept]
        seen = fewer
    return seen, left_out


def shown_by(found: dict, made_up: Sequence[dict]) -> bool:
    """Whether a sensor makes up an effect, and half as much of it at least as was found; both as in report.json."""

    def change(effect: dict) -> float:
        return max(abs(p["estimate"] - p["nominal"]) for p in effect["parameters"].values())

    same = [e for e in made_up if (e["effect"], e["target"]) == (found["effect"], found["target"])]
    return any(change(e) > 0.5 * change(found) for e in same)


def discover(
    task: Task, source: Domain, sensor: Sensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: Discovery, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
) -> dict:  # fmt: skip
    """Diagnose the source by the target's images, and the sensor by the source's.

    Args:
        task: whose states tell positions.
        source: the domain to be repaired, with what has been found so far.
        sensor: reads target images.
        G: shows source images as target images.
        target: trajectory files of the target; images and actions are all that is used.
        control: trajectory files of the source as it is now, with images and states; the sensor was not fitted to them.
        options: what to look for.
        seed: of the choice of windows.
        make_env: simulations of a domain, so many side by side, with images as the sensor takes them.

    Returns:
        ``effects`` found (a list as in effects.yaml), ``disbelieved`` ones, and those ``left_out`` since too little
        goes with them beyond the others (as in report.json); ``excess``, the largest ratio of a
        channel's error in the target to that in the control, and the share of what is beyond the control's that was
        ``explained`` in that channel; the shares of the whole error ``removed`` in target and control; the diagnosis's
        ``estimates``, and what the sensor ``made_up`` in the control; the errors of the ``sensor`` there, for each
        degree of freedom, the ``unknown_gain`` that intervals allow for, and the shares of frames left ``unread``; the
        error ``before`` and ``after``, in units of the sensor's noise, and that of the channels of ``target`` and
        ``control``.
    """
    model = source.compile()
    readings = read_calibrated(sensor, source, target, control, G, seed, learn=False)
    if readings.calibration.vague:
        return discover_by_forecasts(task, source, sensor, G, target, control, options, seed, make_env, readings)
    read, calibration = (readings.target, readings.control), readings.calibration
    # Pieces of one length, so that both are judged over the same horizon.
    length = max(SHORTEST, int(min(np.quantile([len(e) for e in d], 0.75) for d in read)))

    # The source keeps its numerics, so what is found must hold with them.
    def diagnosed(data: Trajectories, most: int) -> Diagnosis:
        return diagnose(
            source.spec(), pieces(data, length), candidates=options.candidates, seed=seed,
            settings=Settings(max_effects=most, numerics=False), unmeasured=readings.unmeasured,
            noise=calibration.noise(model, task.unseen),
        )  # fmt: skip

    checked = diagnosed(readings.control, options.max_effects)
    seen, left_out = worth_it(partial(diagnosed, readings.target), options.max_effects, checked)
    estimates, made_up = seen.report["effects"], checked.report["effects"]
    errors = [d.report["error"]["per_channel"] for d in (seen, checked)]
    excess, explained = beyond_the_control(*errors)
    gone, made_up_share = (removed(d.report["error"]) for d in (seen, checked))
    trusted = believable(excess, explained, gone, made_up_share)
    real = {(e["effect"], e["target"]) for e in estimates if trusted and not shown_by(e, made_up)}
    believed = [e for e in seen.effects if (e.name, e.target) in real]
    for e in estimates:
        log.info("effect found from images: %s", e)
    for e in left_out:
        log.info("left out, since it says too little beyond those before it: %s", e)
    return {
        "effects": [e.to_dict() for e in believed],
        "disbelieved": [e.to_dict() for e in seen.effects if e not in believed],
        "left_out": left_out,
        "estimates": estimates,
        "made_up": made_up,
        "excess": excess,
        "explained": explained,
        "removed": {"target": gone, "control": made_up_share},
        "unread": {name: round(share, 5) for name, share in readings.unread.items()},
        "sensor": calibration.to_dict(model, task.unseen),
        "unknown_gain": GAIN,
        "before": seen.report["error"]["before"],
        "after": seen.report["error"]["after"],
        "target": errors[0],
        "control": errors[1],
    }


def discover_by_forecasts(
    task: Task, source: Domain, sensor: Sensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: Discovery, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
    readings: Readings,
) -> dict:  # fmt: skip
    """As :func:`discover`, for a sensor that cannot tell how fast things move; ``readings`` are what it read.

    Errors ``before`` and ``after`` are energy scores then, channels those of forecasts, and ``forecasts`` is true.
    """
    model, dt = source.compile(), readings.target.dt
    compared, calibration = Compared(task, model), readings.calibration
    seen = sightings(sensor, read_all(target), dt, compared)
    known = sightings(sensor, read_all(control, also="state"), dt, compared, G)
    exact = by_images(seen, sensor, G, compared, make_env, dt)
    quick = by_states(seen, compared, calibration.position, dt, seed)
    recorded, _ = recordings(model, readings.target)
    around = surroundings(model, recorded, STEPS * dt)
    candidates = [c for c in choose(library(source.spec(), around), options.candidates) if c.size == 1]
    found, next_best = search(source, candidates, quick, exact, options.max_effects, seed)

    repaired = source.with_effects(*(s.effect for s in found))
    in_control = replace(exact, sightings=known)
    before, after, there = (
        float(f.scores(d, seed).mean()) for f, d in ((exact, source), (exact, repaired), (in_control, source))
    )
    return {
        "effects": [s.effect.to_dict() for s in found],
        "disbelieved": [s.effect.to_dict() for s in next_best],
        "left_out": [],
        "estimates": [told(s, model, before) for s in (*found, *next_best)],
        "made_up": [],
        "excess": before / there,
        "explained": (before - after) / (before - there) if before > there else 0.0,
        "removed": {"target": 1 - after / before, "control": 0.0},
        "unread": {name: round(share, 5) for name, share in readings.unread.items()},
        "sensor": calibration.to_dict(model, task.unseen),
        "forecasts": True,
        "before": before,
        "after": after,
        "target": told_channels(compared, calibration, exact.errors(source, seed), exact.errors(repaired, seed)),
        "control": told_channels(compared, calibration, *[in_control.errors(source, seed)] * 2),
    }


def told_channels(compared: Compared, calibration: Calibration, before: np.ndarray, after: np.ndarray) -> dict:
    """Errors of what is compared, as channels of report.json."""
    joints = [compared.model.joint(compared.model.dof_jntid[i]) for i in compared.dofs]
    turns = [int(j.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE) for j in joints]
    names = [j.name for j in joints] + [f"{j.name} velocity" for j in joints]
    units = ["rad" if t else "m" for t in turns] + ["rad/s" if t else "m/s" for t in turns]
    noise = np.concatenate([calibration.position[compared.dofs], calibration.velocity[compared.dofs]])
    return {
        name: {"before": rounded(b), "after": rounded(a), "noise": rounded(n), "unit": unit}
        for name, b, a, n, unit in zip(names, before, after, noise, units, strict=True)
    }

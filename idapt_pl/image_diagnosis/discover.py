"""Which physical effect does the source lack? Found from the target's images and actions alone.

An estimator of the state, fitted to what G shows of the source, turns the target's images into positions and
velocities. Where it tells how fast things move, windows of what it read are replayed; where it does not, the source
with an effect must forecast what it reads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from datamodules.unpaired import read_all
from idapt_pl.diagnosis.candidates import all_candidates, typical_sizes
from idapt_pl.diagnosis.data import as_recordings
from idapt_pl.diagnosis.prepare import choose_candidates
from idapt_pl.effects import Domain
from idapt_pl.effects.candidate import Candidate
from idapt_pl.envs import VectorImageEnv
from idapt_pl.image_diagnosis.calibration import Readings, read_calibrated
from idapt_pl.image_diagnosis.channels import channel_errors, example_episode
from idapt_pl.image_diagnosis.forecast_search import search_by_forecasts, trial_entry
from idapt_pl.image_diagnosis.forecasts import (
    FORECAST_STEPS,
    ComparedChannels,
    image_forecaster,
    observed_starts,
    state_forecaster,
)
from idapt_pl.image_diagnosis.parabola import SYSTEMATIC_LOG_STD
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE, DiscoverySettings
from idapt_pl.image_diagnosis.windows import diagnose_by_windows
from idapt_pl.modules import VisualTransformation


def discover_effects(
    source: Domain, sensor: ImageSensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: DiscoverySettings, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
) -> dict:  # fmt: skip
    """Find the effects that the target's images show the source to lack.

    Args:
        source: the domain to be repaired, with what has been found so far.
        sensor: reads target images; its task's states tell positions.
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
    readings = read_calibrated(sensor, source, target, control, G)
    if readings.calibration.vague:
        return diagnose_by_forecasts(source, sensor, G, target, control, options, seed, make_env, readings)
    return diagnose_by_windows(sensor.task, source, readings, options, seed)


def diagnose_by_forecasts(
    source: Domain, sensor: ImageSensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: DiscoverySettings, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
    readings: Readings,
) -> dict:  # fmt: skip
    """For a sensor that cannot tell how fast things move; ``readings`` are what it read, the rest as above.

    Errors ``before`` and ``after`` are energy scores then, channels those of forecasts, ``forecasts`` is true, one
    episode an ``example``, nothing is sought in the control, and intervals allow for an ``unknown_error``.
    """
    task, model, dt = sensor.task, source.compile(), readings.target.dt
    compared, calibration = ComparedChannels(task, model), readings.calibration
    seen = observed_starts(sensor, read_all(target), dt, compared)
    if len(seen) < 2:
        raise ValueError(
            f"{', '.join(map(str, target))}: {len(seen)} episodes last {SHORTEST_EPISODE} control steps; effects are judged by "
            "forecasts of such, and at least 2 are needed"
        )
    known = observed_starts(sensor, read_all(control, also="state"), dt, compared, G)
    exact = image_forecaster(seen, sensor, G, compared, make_env, dt)
    quick = state_forecaster(seen, source, compared, calibration.position, dt, seed)
    recorded, _ = as_recordings(model, readings.target)
    around = typical_sizes(model, recorded, FORECAST_STEPS * dt)
    candidates = of_one_parameter(choose_candidates(all_candidates(source.spec(), around), options.candidates))
    found, next_best = search_by_forecasts(source, candidates, quick, exact, options.max_effects, seed)

    repaired = source.with_effects(*(s.effect for s in found))
    in_control = replace(exact, sightings=known)
    first = exact.ensembles(source, seed)
    last = exact.ensembles(repaired, seed) if found else first
    its_own = in_control.ensembles(source, seed)
    before, after = exact.scores_of(first), exact.scores_of(last)
    was, now, there = (float(x.mean()) for x in (before, after, in_control.scores_of(its_own)))
    return {
        "effects": [s.effect.to_dict() for s in found],
        "disbelieved": [s.effect.to_dict() for s in next_best],
        "left_out": [],
        "estimates": [trial_entry(s, model, was) for s in (*found, *next_best)],
        "made_up": [],
        "excess": was / there,
        "explained": (was - now) / (was - there) if was > there else 0.0,
        "removed": {"target": 1 - now / was},
        "unread": {name: round(share, 5) for name, share in readings.unread.items()},
        "sensor": calibration.to_dict(model, task.unseen),
        "unknown_error": SYSTEMATIC_LOG_STD,
        "forecasts": True,
        "before": was,
        "after": now,
        "target": channel_errors(compared, calibration, exact.errors_of(first), exact.errors_of(last)),
        "control": channel_errors(compared, calibration, *[in_control.errors_of(its_own)] * 2),
        "example": example_episode(compared, seen, first, last, before - after, dt),
    }


def of_one_parameter(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that forecasts can judge.

    Raises:
        ValueError: naming an effect of which none is.
    """
    single = [c for c in candidates if c.size == 1]
    if several := sorted({c.kind.name for c in candidates} - {c.kind.name for c in single}):
        raise ValueError(f"{several[0]} has several parameters, and forecasts judge effects of one: leave it out")
    return single

"""Effects found by replaying short windows of what a sensor read; for sensors that tell how fast things move.

The diagnosis looks for the effect with which the source replays what was read of the target. The sensor errs in ways
that depend on the state, so the same diagnosis is made a second time on recordings of the source, seen through G: there
nothing is missing, and what is found is an error of the sensor. What is found in the target is believed if the error
there is clearly larger and most of the difference goes with it, or if a good share of the error goes with it and none
such in the control; and if it is something else, or far more of the same. Of several effects each must say so for
itself, of what is left when it is left out.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from datamodules import Trajectories
from idapt_pl.diagnosis.search import Diagnosis, diagnose
from idapt_pl.diagnosis.settings import SearchSettings
from idapt_pl.effects import Domain
from idapt_pl.image_diagnosis.calibration import GAIN_STD, Readings, sub_episode
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE, DiscoverySettings
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
CREDIBLE_EXCESS = ((3.0, 0.5), (2.0, 0.9))
"""How many times as large as in the control the error must be in some channel of the target, and what share of what is
beyond the control's error there must go with what is found; either pair will do.

The sensor was fitted to images like the control's, so it errs more on the target even where nothing is missing: 1.0 to
1.8 times on the pendulum (``benchmarks/discovery.py --cases nothing``), 2.0 to 7.7 times on HalfCheetah."""
CREDIBLE_REMOVED = 0.3
"""Or the share of the whole error that must go with what is found, if it is also twice what goes in the control.

Motions in the target can be calmer than those of the control, and easier to read: then no channel's error is larger
than the control's, whatever is missing. Where nothing was missing up to 0.09 of it went on the pendulum, none on
HalfCheetah, and 0.33 on Walker2d, by velocities that its sensor could not read (``results/discovery.csv``, before and
after); 0.13 now."""


def equal_pieces(data: Trajectories, length: int) -> Trajectories:
    """Episodes cut into pieces of ``length`` control steps; what is left over at an end is dropped."""
    parts = (sub_episode(e, i, i + length + 1) for e in data for i in range(0, len(e) - length + 1, length))
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


def removed_error_share(error: dict) -> float:
    """The share of the error, as in report.json, that goes with all that was found."""
    return 1.0 - error["after"] / error["before"] if error["before"] else 0.0


def believable(excess: float, explained: float, gone: float, made_up_share: float) -> bool:
    """Whether errors say that something is missing in the target, not only in what the sensor reads.

    Args:
        excess: as of :func:`beyond_the_control`.
        explained: the same.
        gone: :func:`removed_error_share` in the target.
        made_up_share: and in the control.
    """
    beyond = any(excess > more and explained > share for more, share in CREDIBLE_EXCESS)
    return beyond or gone > max(CREDIBLE_REMOVED, 2 * made_up_share)


def worth_adding(fewer: dict, seen: dict, control: dict) -> bool:
    """Whether one effect more is worth it: errors with it against those with the ones before it.

    Args:
        fewer: ``error`` of report.json without it.
        seen: with it.
        control: that of the control.
    """
    left = {name: {"before": e["after"], "after": seen["per_channel"][name]["after"]}
            for name, e in fewer["per_channel"].items()}  # fmt: skip
    gone = 1.0 - (1.0 - removed_error_share(seen)) / max(1.0 - removed_error_share(fewer), 1e-12)
    return believable(*beyond_the_control(left, control["per_channel"]), gone, removed_error_share(control))


def drop_unconvincing(
    diagnosed: Callable[[int], Diagnosis], most: int, control: Diagnosis
) -> tuple[Diagnosis, list[dict]]:
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
        if worth_adding(fewer.report["error"], seen.report["error"], control.report["error"]):
            break
        kept = [(e["effect"], e["target"]) for e in fewer.report["effects"]]
        left_out += [e for e in seen.report["effects"] if (e["effect"], e["target"]) not in kept]
        seen = fewer
    return seen, left_out


def sensor_makes_up(found: dict, made_up: Sequence[dict]) -> bool:
    """Whether a sensor makes up an effect, and half as much of it at least as was found; both as in report.json."""

    def change(effect: dict) -> float:
        return max(abs(p["estimate"] - p["nominal"]) for p in effect["parameters"].values())

    same = [e for e in made_up if (e["effect"], e["target"]) == (found["effect"], found["target"])]
    return any(change(e) > 0.5 * change(found) for e in same)


def diagnose_by_windows(task: Task, source: Domain, readings: Readings, options: DiscoverySettings, seed: int) -> dict:
    """Diagnose the source by what was read of the target, and the sensor by what it read of the source.

    Args:
        task: whose states tell positions.
        source: the domain to be repaired.
        readings: of a sensor that tells how fast things move.
        options: what to look for.
        seed: of the choice of windows.

    Returns:
        As of :func:`idapt_pl.image_diagnosis.discover`.
    """
    model = source.compile()
    read, calibration = (readings.target, readings.control), readings.calibration
    # Pieces of one length, so that both are judged over the same horizon.
    length = max(SHORTEST_EPISODE, int(min(np.quantile([len(e) for e in d], 0.75) for d in read)))

    # The source keeps its numerics, so what is found must hold with them.
    def diagnosed(data: Trajectories, most: int) -> Diagnosis:
        return diagnose(
            source.spec(), equal_pieces(data, length), candidates=options.candidates, seed=seed,
            settings=SearchSettings(max_effects=most, numerics=False), unmeasured=readings.unmeasured,
            noise=calibration.noise(model, task.unseen),
        )  # fmt: skip

    checked = diagnosed(readings.control, options.max_effects)
    seen, left_out = drop_unconvincing(partial(diagnosed, readings.target), options.max_effects, checked)
    estimates, made_up = seen.report["effects"], checked.report["effects"]
    errors = [d.report["error"]["per_channel"] for d in (seen, checked)]
    excess, explained = beyond_the_control(*errors)
    gone, made_up_share = (removed_error_share(d.report["error"]) for d in (seen, checked))
    trusted = believable(excess, explained, gone, made_up_share)
    real = {(e["effect"], e["target"]) for e in estimates if trusted and not sensor_makes_up(e, made_up)}
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
        "unknown_gain": GAIN_STD,
        "before": seen.report["error"]["before"],
        "after": seen.report["error"]["after"],
        "target": errors[0],
        "control": errors[1],
    }

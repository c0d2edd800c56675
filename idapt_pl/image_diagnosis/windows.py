"""Effects found by replaying short windows of what a sensor read; for sensors that tell how fast things move.

The diagnosis looks for the effect with which the source replays what was read of the target. The sensor errs in ways
that depend on the state, so the same diagnosis is made a second time on recordings of the source, seen through G: there
nothing is missing, and what is found is an error of the sensor. What is found in the target is believed if the error
there is clearly larger and most of the difference goes with it, or if a good share of the error goes with it and none
such in the control; and if it is something else, or far more of the same. Where errors are within the sensor's noise
its interval must not hold what the model has. Of several effects each must say so for itself, of what is left when it
is left out.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from datamodules import Trajectories
from idapt_pl.diagnosis.answer.result import ChannelError, EffectEstimate
from idapt_pl.diagnosis.search import Diagnosis, diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects import Domain, Effect
from idapt_pl.image_diagnosis.calibration import GAIN_STD, CalibratedReadings, sub_episode
from idapt_pl.image_diagnosis.result import ImageDiagnosis, WindowEvidence
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE, DiscoverySettings
from idapt_pl.tasks import Task

log = logging.getLogger(__name__)
CREDIBLE_EXCESS = ((3.0, 0.5), (2.0, 0.9))
"""How many times as large as in the control the error must be in some channel of the target, and what share of what is
beyond the control's error there must go with what is found; either pair will do.

The sensor was fitted to images like the control's, so it errs more on the target even where nothing is missing: 1.0 to
1.8 times on the pendulum (``benchmarks/discovery.py --cases nothing``), 1.4 to 7.7 times on HalfCheetah."""
CREDIBLE_REMOVED = 0.3
"""Or the share of the whole error that must go with what is found, if it is also twice what goes in the control.

Motions in the target can be calmer than those of the control, and easier to read: then no channel's error is larger
than the control's, whatever is missing. Where nothing is missing up to 0.10 of it goes on the pendulum and 0.13 on
HalfCheetah (``benchmarks/discovery.py --cases nothing``; ``before`` and ``after`` in ``results/discovery.csv``). On
Walker2d it was 0.13 and once 0.34: sensors like that one are left to forecasts."""


@dataclass(frozen=True)
class WindowDiagnosis:
    """What a diagnosis by windows found in recordings of one kind.

    Attributes:
        effects: to be added to the source.
        estimates: their parameters.
        before: error of all channels without them, in units of the sensor's noise.
        after: with them.
        channels: channel to its errors.
    """

    effects: tuple[Effect, ...]
    estimates: tuple[EffectEstimate, ...]
    before: float
    after: float
    channels: Mapping[str, ChannelError]

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> WindowDiagnosis:
        """What is looked at of a diagnosis."""
        found, error = diagnosis.result.effects, diagnosis.result.error
        return cls(
            tuple(e for e in diagnosis.effects if e not in diagnosis.declared),
            tuple(found),
            error.before,
            error.after,
            error.channels,
        )

    @property
    def removed_share(self) -> float:
        """The share of the error that goes with all that was found."""
        return 1.0 - self.after / self.before if self.before else 0.0


def equal_pieces(data: Trajectories, length: int) -> Trajectories:
    """Episodes cut into pieces of ``length`` control steps; what is left over at an end is dropped."""
    parts = (sub_episode(e, i, i + length + 1) for e in data for i in range(0, len(e) - length + 1, length))
    return Trajectories(tuple(parts), data.dt, data.source)


def beyond_the_control(target: Mapping[str, ChannelError], control: Mapping[str, ChannelError]) -> tuple[float, float]:
    """In the channel where the target's error exceeds the control's most: by what factor, and what share was removed.

    Args:
        target: channel to its errors.
        control: the same, where nothing is missing.
    """
    ratios = {name: c.before / control[name].before for name, c in target.items()}
    worst = max(ratios, key=lambda name: ratios[name])
    beyond = target[worst].before - control[worst].before
    removed = target[worst].before - target[worst].after
    return ratios[worst], removed / beyond if beyond > 0 else 0.0


def is_believable(excess: float, explained: float, removed: float, removed_in_control: float) -> bool:
    """Whether errors say that something is missing in the target, not only in what the sensor reads.

    Args:
        excess: as of :func:`beyond_the_control`.
        explained: the same.
        removed: share of the target's error that goes with what was found.
        removed_in_control: and of the control's.
    """
    beyond = any(excess > more and explained > share for more, share in CREDIBLE_EXCESS)
    return beyond or removed > max(CREDIBLE_REMOVED, 2 * removed_in_control)


def is_worth_adding(fewer: WindowDiagnosis, more: WindowDiagnosis, control: WindowDiagnosis) -> bool:
    """Whether one effect more is worth it: errors with it against those with the ones before it.

    Args:
        fewer: without it.
        more: with it.
        control: of the control.
    """
    left = {name: replace(c, before=c.after, after=more.channels[name].after) for name, c in fewer.channels.items()}
    removed = 1.0 - (1.0 - more.removed_share) / max(1.0 - fewer.removed_share, 1e-12)
    return is_believable(*beyond_the_control(left, control.channels), removed, control.removed_share)


def drop_unconvincing(
    diagnose_target: Callable[[int], WindowDiagnosis], most: int, control: WindowDiagnosis
) -> tuple[WindowDiagnosis, tuple[EffectEstimate, ...]]:
    """The diagnosis with at most so many effects, less the last ones found that do not say enough for themselves.

    A sensor errs on the target, and the effect that is there seldom accounts for all of what it reads: the next one
    found then makes up for the sensor.

    Args:
        diagnose_target: the target's diagnosis with at most so many effects.
        most: that are looked for.
        control: the control's.

    Returns:
        It, and the effects left out.
    """
    kept = diagnose_target(most)
    negligible: tuple[EffectEstimate, ...] = ()
    while (count := len(kept.estimates)) > 1:
        fewer = diagnose_target(count - 1)
        if is_worth_adding(fewer, kept, control):
            break
        keys = [e.key for e in fewer.estimates]
        negligible += tuple(e for e in kept.estimates if e.key not in keys)
        kept = fewer
    return kept, negligible


def is_sensor_error(estimate: EffectEstimate, found_in_control: Sequence[EffectEstimate]) -> bool:
    """Whether an effect is found in the control too, and half as much of it at least."""

    def change(e: EffectEstimate) -> float:
        return max(abs(float(p.estimate) - float(p.nominal or 0.0)) for p in e.parameters.values())

    return any(change(e) > 0.5 * change(estimate) for e in found_in_control if e.key == estimate.key)


def is_within_noise(estimate: EffectEstimate, before: float) -> bool:
    """Whether nothing tells that an effect is there.

    It may be as the model has it, by the intervals of all its parameters, and without it the error is already below 1,
    what the sensor's noise alone makes. Above it, one effect may hide how sure another is.
    """
    return before < 1 and all(
        p.ci95 is not None and isinstance(p.nominal, int | float) and p.ci95[0] < p.nominal < p.ci95[1]
        for p in estimate.parameters.values()
    )


def diagnose_by_windows(
    task: Task, source: Domain, readings: CalibratedReadings, options: DiscoverySettings, seed: int
) -> ImageDiagnosis:
    """Diagnose the source by what was read of the target, and the sensor by what it read of the source.

    Args:
        task: whose states tell positions.
        source: the domain to be repaired.
        readings: of a sensor that tells how fast things move.
        options: what to look for.
        seed: of the choice of windows.
    """
    model, calibration = source.compile(), readings.calibration
    # Pieces of one length, so that both are judged over the same horizon.
    lengths = (np.quantile([len(e) for e in read], 0.75) for read in (readings.target, readings.control))
    length = max(SHORTEST_EPISODE, int(min(lengths)))

    # The source keeps its numerics, so what is found must hold with them. The target may be another simulation.
    def diagnose_pieces(data: Trajectories, most: int) -> WindowDiagnosis:
        return WindowDiagnosis.of(diagnose(
            source.within_mjcf.spec(), equal_pieces(data, length), source.beyond_mjcf, candidates=options.candidates,
            seed=seed, settings=SearchSettings(max_effects=most, numerics=False, plausible=False),
            unmeasured=readings.unmeasured, noise=calibration.noise(model, task.unseen), laws=False,
            threads=torch.get_num_threads(),
        ))  # fmt: skip

    control = diagnose_pieces(readings.control, options.max_effects)
    target, negligible = drop_unconvincing(partial(diagnose_pieces, readings.target), options.max_effects, control)
    excess, explained = beyond_the_control(target.channels, control.channels)
    trusted = is_believable(excess, explained, target.removed_share, control.removed_share)
    doubtful = [
        e.key for e in target.estimates if is_sensor_error(e, control.estimates) or is_within_noise(e, target.before)
    ]
    real = {e.key for e in target.estimates if trusted and e.key not in doubtful}
    for e in target.estimates:
        log.info("effect found from images: %s", e.to_dict())
    for e in negligible:
        log.info("left out, since it says too little beyond those before it: %s", e.to_dict())
    return ImageDiagnosis(
        effects=tuple(e for e in target.effects if (e.name, e.target) in real),
        rejected=tuple(e for e in target.effects if (e.name, e.target) not in real),
        estimates=target.estimates,
        excess=excess,
        explained=explained,
        removed={"target": target.removed_share, "control": control.removed_share},
        excluded_frames={name: round(share, 5) for name, share in readings.excluded_frames.items()},
        sensor_errors=calibration.to_dict(model, task.unseen),
        before=target.before,
        after=target.after,
        target=dict(target.channels),
        control=dict(control.channels),
        evidence=WindowEvidence(control.estimates, negligible, GAIN_STD),
    )

"""Effects found by forecasts of what a sensor reads; for sensors that cannot tell how fast things move."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datamodules import Episode
from datamodules.unpaired import read_all
from idapt_pl.diagnosis.answer.result import ChannelError
from idapt_pl.diagnosis.candidates.listing import all_candidates, typical_sizes
from idapt_pl.diagnosis.prepare import choose_candidates
from idapt_pl.effects import Domain
from idapt_pl.effects.candidate import Candidate
from idapt_pl.envs import VectorImageEnv
from idapt_pl.image_diagnosis.calibration import CalibratedReadings, Calibration
from idapt_pl.image_diagnosis.channels import ComparedChannels
from idapt_pl.image_diagnosis.forecast_search import search_by_forecasts, six_digits, trial_estimate
from idapt_pl.image_diagnosis.forecasts import (
    FORECAST_STEPS,
    ObservedStart,
    image_forecaster,
    long_enough,
    observed_starts,
    state_forecaster,
)
from idapt_pl.image_diagnosis.parabola import SYSTEMATIC_LOG_STD
from idapt_pl.image_diagnosis.result import (
    EnsembleBand,
    ForecastChannel,
    ForecastEvidence,
    ForecastExample,
    ImageDiagnosis,
)
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import SHORTEST_EPISODE, DiscoverySettings
from idapt_pl.modules import VisualTransformation
from idapt_pl.prediction.data import as_recordings

log = logging.getLogger(__name__)
EPISODES_LEAST = 2
"""Of the target, to judge effects by."""


def diagnose_by_forecasts(
    source: Domain, sensor: ImageSensor, G: VisualTransformation, target: Sequence[Path],
    control: Sequence[Path], options: DiscoverySettings, seed: int, make_env: Callable[[Domain, int], VectorImageEnv],
    readings: CalibratedReadings, paired_steps: int = 0,
) -> ImageDiagnosis:  # fmt: skip
    """Diagnose the source by forecasts; nothing is sought in the control.

    Args:
        source: the domain to be repaired.
        sensor: reads target images.
        G: shows source images as target images.
        target: trajectory files of the target.
        control: trajectory files of the source.
        options: what to look for.
        seed: of resets.
        make_env: simulations of a domain, so many side by side, with images as the sensor takes them.
        readings: what the sensor read of both.
        paired_steps: control steps from where episodes begin that G learned as pairs; they are not judged, if enough
            episodes outlast them.

    Raises:
        ValueError: if fewer than two of the target's episodes are long enough, or a candidate has several parameters.
    """
    model, dt = source.compile(), readings.target.dt
    compared, calibration = ComparedChannels(sensor.task, model), readings.calibration
    seen, own = read_all(target), read_all(control, also="state")
    begin = first_judged(paired_steps, seen, own)
    starts = observed_starts(sensor, seen, dt, compared, begin=begin)
    check_enough(starts, target)
    control_starts = observed_starts(sensor, own, dt, compared, G, begin)
    exact = image_forecaster(starts, sensor, G, compared, make_env, dt, begin)
    quick = state_forecaster(starts, source, compared, calibration.position, dt, seed, begin)
    candidates = forecast_candidates(source, readings, options)
    accepted, next_best = search_by_forecasts(source, candidates, quick, exact, options.max_effects, seed)

    repaired = source.with_effects(*(t.effect for t in accepted))
    in_control = replace(exact, starts=control_starts)
    first = exact.ensembles(source, seed)
    last = exact.ensembles(repaired, seed) if accepted else first
    its_own = in_control.ensembles(source, seed)
    scores_before, scores_after = exact.scores_of(first), exact.scores_of(last)
    before, after, floor = (float(x.mean()) for x in (scores_before, scores_after, in_control.scores_of(its_own)))
    return ImageDiagnosis(
        effects=tuple(t.effect for t in accepted),
        rejected=tuple(t.effect for t in next_best),
        estimates=tuple(trial_estimate(t, model, before) for t in (*accepted, *next_best)),
        excess=before / floor,
        explained=(before - after) / (before - floor) if before > floor else 0.0,
        removed={"target": 1 - after / before},
        excluded_frames={name: round(share, 5) for name, share in readings.excluded_frames.items()},
        sensor_errors=calibration.to_dict(model, sensor.task.unseen),
        before=before,
        after=after,
        target=channel_errors(compared, calibration, exact.errors_of(first), exact.errors_of(last)),
        control=channel_errors(compared, calibration, *[in_control.errors_of(its_own)] * 2),
        evidence=ForecastEvidence(
            SYSTEMATIC_LOG_STD, example_episode(compared, starts, first, last, scores_before - scores_after, dt)
        ),
    )


def first_judged(paired_steps: int, *recorded: Iterable[Episode]) -> int:
    """The control step from which forecasts are judged: after the pairs, or the first where too few last so long."""
    if min(len(long_enough(episodes, paired_steps)) for episodes in recorded) >= EPISODES_LEAST:
        return paired_steps
    if paired_steps:
        log.warning("too few episodes outlast the %d steps that G learned as pairs: all are judged", paired_steps)
    return 0


def check_enough(starts: Sequence[ObservedStart], target: Sequence[Path]) -> None:
    """Refuse to judge effects by fewer episodes of the target than :data:`EPISODES_LEAST`."""
    if len(starts) < EPISODES_LEAST:
        raise ValueError(
            f"{', '.join(map(str, target))}: {len(starts)} episodes last {SHORTEST_EPISODE} control steps; effects are "
            f"judged by forecasts of such, and at least {EPISODES_LEAST} are needed"
        )


def forecast_candidates(source: Domain, readings: CalibratedReadings, options: DiscoverySettings) -> list[Candidate]:
    """The candidates asked for, in the sizes of what was read of the target."""
    recorded, _ = as_recordings(source.compile(), readings.target)
    sizes = typical_sizes(source.compile(), recorded, FORECAST_STEPS * readings.target.dt)
    return of_one_parameter(choose_candidates(all_candidates(source.spec(), sizes), options.candidates))


def of_one_parameter(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that forecasts can judge.

    Raises:
        ValueError: naming an effect of which none is.
    """
    single = [c for c in candidates if c.size == 1]
    if several := sorted({c.kind.name for c in candidates} - {c.kind.name for c in single}):
        raise ValueError(f"{several[0]} has several parameters, and forecasts judge effects of one: leave it out")
    return single


def channel_errors(
    compared: ComparedChannels, calibration: Calibration, before: np.ndarray, after: np.ndarray
) -> dict[str, ChannelError]:
    """Errors (d,) of the means of forecasts, without and with effects, beside the sensor's."""
    noise = np.concatenate([calibration.position[compared.dofs], calibration.velocity[compared.dofs]])
    return {
        name: ChannelError(six_digits(without), six_digits(with_effects), six_digits(sensor), unit)
        for (name, unit), without, with_effects, sensor in zip(
            compared.names_and_units(), before, after, noise, strict=True
        )
    }


def example_episode(
    compared: ComparedChannels,
    starts: Sequence[ObservedStart],
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    gains: np.ndarray,
    dt: float,
) -> ForecastExample:
    """The episode that gains as much as most do: its positions as read, and ensembles without and with effects.

    Args:
        compared: the channels.
        starts: of the target's episodes.
        before: ensembles of each, (members, T+1, d), without effects.
        after: with them; the same where there are none.
        gains: of each, (n,), of any scale.
        dt: control period, s.
    """
    k = int(np.argsort(gains, kind="stable")[len(gains) // 2])

    def sequence(values: np.ndarray) -> tuple[float, ...]:
        return tuple(map(six_digits, values))

    def band(members: np.ndarray) -> EnsembleBand:
        return EnsembleBand(*map(sequence, (members.mean(0), members.min(0), members.max(0))))

    positions = enumerate(compared.names_and_units()[: len(compared.dofs)])
    return ForecastExample(
        dt,
        {
            name: ForecastChannel(unit, sequence(starts[k].read[:, i]), band(before[k][..., i]), band(after[k][..., i]))
            for i, (name, unit) in positions
        },
    )

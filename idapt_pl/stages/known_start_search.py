"""Which effect a source lacks, by forecasts from known starts; for where nothing could be told from windows."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.effects import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.image_diagnosis.calibration import read_calibrated
from idapt_pl.image_diagnosis.forecast_diagnosis import forecast_candidates
from idapt_pl.image_diagnosis.forecast_search import GAIN_SHARE, STANDARD_ERRORS, first_values, six_digits
from idapt_pl.image_diagnosis.sensor import ImageSensor
from idapt_pl.image_diagnosis.settings import DiscoverySettings
from idapt_pl.modules import AsymmetricSAC, VisualTransformation
from idapt_pl.stages.context import StageContext
from idapt_pl.stages.refinement import (
    Errors,
    KnownStartForecasts,
    Refined,
    known_start_forecasts,
    refine_parameters,
)

log = logging.getLogger(__name__)

RECORDINGS_JUDGED, STEPS_JUDGED, MEMBERS_JUDGED = 60, 15, 24
"""Recordings, their first control steps, and simulations that follow each.

Many short ones tell most: a robot that moves otherwise than its source is soon where no estimator has been, and from
each start it is known anew (HalfCheetah's seed 3, which these were chosen on)."""
RECORDINGS_TRIED = 20
"""With which all candidates are tried first."""
JUDGED = 3
"""Candidates that are judged by all recordings, their values refined."""
TOLD = 8
"""Candidates that the result names, the best first."""


@dataclass(frozen=True)
class KnownStartSearch:
    """What a search found: one effect, or nothing.

    Attributes:
        best: the effect that forecasts best, and its parameter; None where none does better than none.
        accepted: whether it is clearly better.
        before: error of forecasts without it.
        after: with it.
        gain: mean gain of recordings, its standard error, and the control's gain as a share of its error.
        tried: candidates, values and errors of the first round, the best first.
    """

    best: tuple[Effect, Refined] | None
    accepted: bool
    before: float
    after: float
    gain: tuple[float, float, float]
    tried: tuple[tuple[str, float, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """As ``known_start_search.json`` has it."""
        effect, how = self.best or (None, None)
        kept = [effect.to_dict()] if self.accepted and effect is not None else []
        gain = dict(zip(("mean", "standard_error", "share_in_control"), map(six_digits, self.gain), strict=True))
        return {
            "effects": kept,
            "best": effect.to_dict() if effect is not None else None,
            "parameters": [dataclasses.asdict(how)] if how is not None else [],
            "error": {"before": self.before, "after": self.after},
            "gain": gain,
            "tried": [{"candidate": c, "value": six_digits(x), "error": six_digits(e)} for c, x, e in self.tried],
        }


def effects_from_known_starts(
    c: StageContext, step: int, settings: DiscoverySettings, sensor: ImageSensor, target: Sequence[Path],
    control: Path, G: VisualTransformation, pi: AsymmetricSAC,
) -> list[dict]:  # fmt: skip
    """The effect found, as it is written, or none; ``known_start_search.json`` says how.

    Args:
        c: of the run.
        step: grounding step.
        settings: which effects are considered.
        sensor: reads target images.
        target: trajectory files, of which images and actions are used.
        control: trajectory file of the source, images and states, that nothing was fitted to.
        G: shows source images as target images.
        pi: its encoder reads target images.
    """

    def make(seed: int) -> dict:
        source = c.worlds.source_domain
        candidates = forecast_candidates(source, read_calibrated(sensor, source, target, [control], G), settings)
        size = RECORDINGS_JUDGED, STEPS_JUDGED, MEMBERS_JUDGED
        forecasts = known_start_forecasts(c, target, control, G, pi, seed, *size)
        return search_from_known_starts(candidates, *forecasts).to_dict()

    return c.stages.measure(step, "known_start_search", make)["effects"]


def search_from_known_starts(
    candidates: Sequence[Candidate], of_target: KnownStartForecasts, of_control: KnownStartForecasts
) -> KnownStartSearch:
    """The effect with which the target's first frames are forecast best, if they are clearly better with it.

    It must be worth what an effect judged by forecasts must (:mod:`~idapt_pl.image_diagnosis.forecast_search`), and
    more than twice as large a share as in the control, where the source lacks nothing: what helps there too makes up
    for the sensor.

    Args:
        candidates: effects of one parameter.
        of_target: forecasts of the target.
        of_control: of the source itself, seen through G.
    """
    tried = screened(candidates, of_target.first(RECORDINGS_TRIED))
    told = tuple((c.label, x, error) for c, x, error in tried[:TOLD])
    without = of_target([])
    before = float(without.mean())
    refined = [refine_parameters([c.effect([x])], of_target) for c, x, _ in tried[:JUDGED]]
    if not refined:
        return KnownStartSearch(None, False, before, before, (0.0, 0.0, 0.0), told)
    errors = [of_target(effects) for effects, _ in refined]
    k = int(np.argmin([e.mean() for e in errors]))
    (effect,), (how, *_) = refined[k]
    gain, spread = paired_gain(without, errors[k], np.arange(len(without)))
    in_control = of_control([])
    share_in_control = 1 - float(of_control([effect]).mean() / in_control.mean())
    clear = gain >= max(STANDARD_ERRORS * spread, GAIN_SHARE * before) and gain > 2 * share_in_control * before
    log.info(
        "from known starts %s forecasts %.3g ± %.2g better than %.3g, the control by %.2g of it: %s",
        effect.to_dict(), gain, spread, before, share_in_control, "added" if clear else "not enough",
    )  # fmt: skip
    return KnownStartSearch(
        (effect, how), bool(clear), before, float(errors[k].mean()), (gain, spread, share_in_control), told
    )


def screened(candidates: Sequence[Candidate], errors: Errors) -> list[tuple[Candidate, float, float]]:
    """Candidates with the value that forecasts best and the error then, the best first, if better than without."""
    without, best = float(errors([]).mean()), []
    for c in candidates:
        tried = [(float(errors([c.effect([x])]).mean()), x) for x in first_values(c)]
        best += [(c, x, error) for error, x in sorted(tried)[:1] if error < without]
    return sorted(best, key=lambda found: found[2])

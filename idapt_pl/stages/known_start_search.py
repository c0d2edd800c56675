"""Which effect a source lacks, by forecasts from known starts (docs/decisions/037)."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.effects import Effect
from idapt_pl.effects.base import ACTUATED
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
    KnownStartForecasts,
    Misfits,
    Refined,
    known_start_forecasts,
    mean_error,
    refine_parameters,
)

log = logging.getLogger(__name__)

RECORDINGS_CHOSEN_BY, MEMBERS_JUDGED = 60, 16
"""Recordings, and simulations that follow each. Many short ones tell most: from each start the robot is known anew."""
RECORDINGS_FRESH, FRESH_LEAST = 60, 20
"""Further recordings, and how many at least, that what was chosen is judged by if there are some: nothing about them
was chosen, so a gain need not make up for being the best of many ..."""
FRESH_GAIN_SHARE = GAIN_SHARE / 2
"""... and half as much is enough, as long as it is as sure."""
RECORDINGS_GLANCED, RECORDINGS_TRIED, MEMBERS_SCREENED = 3, 12, 6
"""With which all candidates are tried first, and then those that did best; and how many simulations follow each.
Three more recordings change the error of a forecast by more than ten more simulations (docs/decisions/086)."""
STAYING, STAYING_LEAST = 0.4, 8
"""Share of the candidates that stay after the first glance, and how many at least; all that are shared stay too.

What all joints have a little of may be 13th of 41 in three recordings, and the best in sixty."""
JUDGED = 3
"""Candidates that are judged by all recordings, their values refined by a few; the best is refined by all."""
TOLD = 8
"""Candidates that the result names, the best first."""


@dataclass(frozen=True)
class KnownStartSearch:
    """What a search found.

    Attributes:
        best: the effects with which forecasts are best, and their parameters; empty where none does better than none.
        accepted: whether they are to be added.
        before: error of forecasts without them, as of :func:`~idapt_pl.stages.refinement.mean_error`.
        after: with them.
        gain: mean gain of recordings, its standard error, and the control's gain, nats.
        tried: candidates, values and errors of the first round, the best first.
    """

    best: tuple[list[Effect], list[Refined]]
    accepted: bool
    before: float
    after: float
    gain: tuple[float, float, float]
    tried: tuple[tuple[str, float, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """As ``known_start_search.json`` has it: no standard error where fewer than half of the recordings gain."""
        effects, how = [e.to_dict() for e in self.best[0]], [dataclasses.asdict(r) for r in self.best[1]]
        finite = [six_digits(x) if np.isfinite(x) else None for x in self.gain]  # JSON has no infinity
        gain = dict(zip(("mean", "standard_error", "in_control"), finite, strict=True))
        return {
            "effects": effects if self.accepted else [],
            "best": effects,
            "parameters": how,
            "error": {"before": self.before, "after": self.after},
            "gain": gain,
            "tried": [{"candidate": c, "value": six_digits(x), "error": six_digits(e)} for c, x, e in self.tried],
        }


def effects_from_known_starts(
    c: StageContext, step: int, settings: DiscoverySettings, sensor: ImageSensor, target: Sequence[Path],
    control: Path, G: VisualTransformation, pi: AsymmetricSAC, paired_steps: int = 0,
) -> list[dict]:  # fmt: skip
    """The effects to add, as they are written; ``known_start_search.json`` says why these.

    Args:
        c: of the run.
        step: grounding step.
        settings: which effects are considered.
        sensor: reads target images.
        target: trajectory files, of which images and actions are used.
        control: trajectory file of the source, images and states, that nothing was fitted to.
        G: shows source images as target images.
        pi: its encoder reads target images.
        paired_steps: control steps from where episodes begin that G learned as pairs; they are not judged.
    """

    def make(seed: int) -> dict:
        source = c.worlds.source_domain
        candidates = forecast_candidates(source, read_calibrated(sensor, source, target, [control], G), settings)
        sizes = RECORDINGS_CHOSEN_BY + RECORDINGS_FRESH, MEMBERS_JUDGED
        forecasts = known_start_forecasts(c, target, control, G, pi, seed, *sizes, paired_steps)
        return search_from_known_starts(candidates, *forecasts).to_dict()

    return c.stages.measure(step, "known_start_search", make)["effects"]


def search_from_known_starts(
    candidates: Sequence[Candidate], of_target: KnownStartForecasts, of_control: KnownStartForecasts
) -> KnownStartSearch:
    """The effect with which the target's first frames are forecast best.

    It must be worth what an effect judged by forecasts must (:mod:`~idapt_pl.image_diagnosis.forecast_search`; a tenth
    of the errors is about 0.1 nats, and half of that is enough in recordings that it was not chosen by), and more than
    twice as much as in the control, where nothing is missing: what helps there too makes up for the sensor.

    Args:
        candidates: effects of one parameter.
        of_target: forecasts of the target.
        of_control: of the source itself, seen through G.
    """
    chosen_by, fresh = of_target.first(RECORDINGS_CHOSEN_BY), of_target.beyond(RECORDINGS_CHOSEN_BY)
    tried = screened(candidates, chosen_by)
    told = tuple((c.label, x, error) for c, x, error in tried[:TOLD])
    few = chosen_by.first(RECORDINGS_TRIED)
    rivals = [refine_parameters([c.effect([x])], few)[0] for c, x, _ in tried[:JUDGED]]
    best = refine_parameters(min(rivals, key=lambda rival: chosen_by(rival).mean(), default=[]), chosen_by)
    judged_by, share = (fresh, FRESH_GAIN_SHARE) if len(fresh.recordings) >= FRESH_LEAST else (chosen_by, GAIN_SHARE)
    without, misfit = judged_by([]), judged_by(best[0])
    gain, clear = gain_of(best[0], without, misfit, of_control, share)
    return KnownStartSearch(best, clear, mean_error(without), mean_error(misfit), gain, told)


def gain_of(
    effects: Sequence[Effect], without: np.ndarray, misfit: np.ndarray, of_control: Misfits, share: float = GAIN_SHARE
) -> tuple[tuple[float, float, float], bool]:
    """What effects gain, its standard error, the control's gain, nats; whether it is ``share`` at least, and sure."""
    if not effects:
        return (0.0, 0.0, 0.0), False
    gain, spread = paired_gain(without, misfit, np.arange(len(without)))
    in_control = float(of_control([]).mean() - of_control(effects).mean())
    least = max(STANDARD_ERRORS * spread, share, 2 * in_control)
    log.info(
        "from known starts %s forecasts %s better than nothing, and the control %.2g",
        labels_of(effects), nats(gain, spread), in_control,
    )  # fmt: skip
    return (gain, spread, in_control), bool(gain > least)


def nats(gain: float, spread: float) -> str:
    """A gain with its standard error, as :func:`~idapt_pl.estimation.intervals.paired_gain` has it, in words."""
    if np.isinf(spread):
        return f"{gain:.3g} nats (fewer than half of the recordings)"
    return f"{gain:.3g} ± {spread:.2g} nats"


def labels_of(effects: Sequence[Effect]) -> str:
    """Effects in a line of the log."""
    return ", ".join(str(e.to_dict()) for e in effects) or "nothing"


def screened(candidates: Sequence[Candidate], of_target: KnownStartForecasts) -> list[tuple[Candidate, float, float]]:
    """Candidates with the value that forecasts best and the error then, the best first, if better than without.

    All are tried on a few recordings, and those that do best there on more, with what joints or motors share.
    """
    by_few = of_target.first(RECORDINGS_TRIED).roughly(MEMBERS_SCREENED)
    glanced = at_their_best(candidates, by_few.first(RECORDINGS_GLANCED))
    staying = [c for c, _, _ in glanced[: max(STAYING_LEAST, round(STAYING * len(glanced)))]]
    shared = [c for c in candidates if c.target in ("*", ACTUATED) and c not in staying]
    without = mean_error(by_few([]))
    tried = at_their_best([*staying, *shared], by_few)
    return [found for found in tried if found[2] < without]


def at_their_best(candidates: Sequence[Candidate], misfit: Misfits) -> list[tuple[Candidate, float, float]]:
    """Candidates with the value that forecasts best and the error then, the best first."""
    best = []
    for c in candidates:
        tried = [(mean_error(misfit([c.effect([x])])), x) for x in first_values(c)]
        best += [(c, x, error) for error, x in sorted(tried)[:1]]
    return sorted(best, key=lambda found: found[2])

"""Which effect makes the source forecast best what is read of the target? Screened by states, judged by images."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.base import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.wording import unit_at
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.image_diagnosis.channels import rounded
from idapt_pl.image_diagnosis.forecasts import Forecaster
from idapt_pl.image_diagnosis.parabola import minimum_uncertainty, parabola_minimum

log = logging.getLogger(__name__)
TIMES = (0.4, 0.75, 1.5, 3.0, 8.0)
"""Of the nominal value where there is one: what the screen tries."""
SCALES = (0.3, 1.0, 3.0)
"""Scales beyond the nominal value: likewise."""
SCREENED = 6
"""Sightings that the screen forecasts."""
FINALISTS = 6
"""Candidates that are judged by images."""
REFINED = 2
"""Of these, how many are looked for a better value of."""
PROMISING = 0.03
"""Share of the score that the best of them must be worth for that, from other resets than it was chosen by."""
OTHER = 1000
"""Seeds so far apart share no resets: what is chosen by some is checked by others."""
VERDICT = 3
"""Ensembles that the verdict is of, each of fresh resets: one more and one less of a few differ by a tenth."""
STRIDE = 0.5
"""Of the logarithm of a parameter, to either side: where the lowest point is first looked for ..."""
AROUND = (-0.5, -0.25, 0.25, 0.5)
"""... and where else scores are taken around it, since each is noisy."""
SURE = 3.0
"""Standard errors that a gain must be worth ..."""
WORTH = 0.1
"""... and the share of the score."""


@dataclass
class ForecastTrial:
    """A candidate with a value of its parameter, and what forecasts with it are worth.

    Attributes:
        candidate: an effect with one parameter.
        x: its value.
        scores: energy score of each sighting, (n,).
        interval: 95 %, or None.
        equivalent: others that do as well.
    """

    candidate: Candidate
    x: float
    scores: np.ndarray
    interval: tuple[float, float] | None = None
    equivalent: list[ForecastTrial] = field(default_factory=list)

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.candidate.effect([self.x])

    @property
    def score(self) -> float:
        """Mean energy score; less is better."""
        return float(self.scores.mean())


def search_by_forecasts(
    source: Domain, candidates: Sequence[Candidate], quick: Forecaster, exact: Forecaster, most: int, seed: int
) -> tuple[list[ForecastTrial], list[ForecastTrial]]:
    """Effects found one after the other, and the one that came next but was not good enough (or none).

    Args:
        source: as it is now.
        candidates: effects with one parameter.
        quick: screens them.
        exact: judges.
        most: effects to find.
        seed: of resets. A gain is measured on others than an estimate was chosen by.
    """
    found: list[ForecastTrial] = []
    while len(found) < most:
        now = source.with_effects(*(s.effect for s in found))
        best = best_trial(now, candidates, quick, exact, seed)
        if best is None:
            break
        fresh = [seed + OTHER * (k + 2) for k in range(VERDICT)]
        without, with_it = (
            np.mean([exact.scores(d, s) for s in fresh], 0) for d in (now, now.with_effects(best.effect))
        )
        gain, error = paired_gain(without, with_it, np.arange(len(without)))
        log.info(
            "%s = %.4g: what is read of the target is forecast %.3g ± %.2g better than %.3g",
            best.candidate.label, best.x, gain, error, without.mean(),
        )  # fmt: skip
        if gain < max(SURE * error, WORTH * without.mean()):
            return found, [best]
        found.append(best)
    return found, []


def best_trial(
    now: Domain, candidates: Sequence[Candidate], quick: Forecaster, exact: Forecaster, seed: int
) -> ForecastTrial | None:
    """The candidate with the best forecasts, its value refined; None where none is promising."""
    judged = [
        evaluate_at(now, s.candidate, s.x, exact, seed)
        for s in screen_by_states(now, candidates, quick, seed)[:FINALISTS]
    ]
    judged.sort(key=lambda s: s.score)
    if not judged or not promising(now, judged[0].effect, exact, seed + OTHER):
        return None
    nearer = [bracket_minimum(now, s, exact, seed) for s in judged[:REFINED]]
    nearer.sort(key=lambda tried: min(s.score for s in tried))
    best = refine_estimate(now, nearer[0], exact, seed)
    others = [s for s in judged if s.candidate.label != best.candidate.label]
    others += [min(tried, key=lambda s: s.score) for tried in nearer[1:]]
    best.equivalent = list({s.candidate.label: s for s in others if indistinguishable_forecasts(best, s)}.values())
    return best


def screen_by_states(now: Domain, candidates: Sequence[Candidate], quick: Forecaster, seed: int) -> list[ForecastTrial]:
    """Candidates with the value that forecasts states best, the best first, without those that make it worse."""
    without = quick.scores(now, seed, SCREENED).mean()
    tried = []
    for c in candidates:
        here = [
            ForecastTrial(c, x, quick.scores(now.with_effects(c.effect([x])), seed, SCREENED)) for x in first_values(c)
        ]
        tried += [min(here, key=lambda s: s.score)] if here else []
    return sorted((s for s in tried if s.score < without), key=lambda s: s.score)


def first_values(c: Candidate) -> list[float]:
    """Values of a candidate's parameter that are tried first."""
    (low,), (high,) = c.bounds()
    (nominal,), (scale,) = c.nominal, c.scale
    at = [nominal * f for f in TIMES if nominal] + [nominal + scale * f for f in SCALES]
    return sorted({float(x) for x in at if low < x <= high and x > 0 and x != nominal})


def indistinguishable_forecasts(best: ForecastTrial, other: ForecastTrial) -> bool:
    """Whether forecasts do not tell two candidates apart."""
    gain, error = paired_gain(other.scores, best.scores, np.arange(len(best.scores)))
    return gain < 2 * error and np.isfinite(error)


def promising(now: Domain, effect: Effect, exact: Forecaster, seed: int) -> bool:
    """Whether it is worth the time to look for a better value: an effect helps from other resets too."""
    without, with_it = (exact.scores(d, seed).mean() for d in (now, now.with_effects(effect)))
    return bool(with_it < (1 - PROMISING) * without)


def bracket_minimum(now: Domain, s: ForecastTrial, exact: Forecaster, seed: int) -> list[ForecastTrial]:
    """A candidate at its first value, to either side, and where a parabola through these is lowest."""
    tried = [s, *(evaluate_at(now, s.candidate, s.x * np.exp(d), exact, seed) for d in (-STRIDE, STRIDE))]
    return [*tried, evaluate_at(now, s.candidate, np.exp(parabola_minimum(*score_curve(tried))[0]), exact, seed)]


def refine_estimate(now: Domain, tried: Sequence[ForecastTrial], exact: Forecaster, seed: int) -> ForecastTrial:
    """The lowest point of a parabola through scores of values all around it, with an interval if it is among them."""
    middle, _ = parabola_minimum(*score_curve(tried))
    c = tried[0].candidate
    tried = [*tried, *(evaluate_at(now, c, np.exp(middle + d), exact, seed) for d in AROUND)]
    best, (middle, among) = min(tried, key=lambda t: t.score), parabola_minimum(*score_curve(tried))
    if not among:
        return best
    half = minimum_uncertainty(score_curve(tried)[0], np.stack([t.scores for t in tried]))
    return replace(best, x=np.exp(middle), interval=(np.exp(middle - half), np.exp(middle + half)))


def score_curve(tried: Sequence[ForecastTrial]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the values tried, and the scores there."""
    return np.log([t.x for t in tried]), np.array([t.score for t in tried])


def evaluate_at(now: Domain, c: Candidate, x: float, exact: Forecaster, seed: int) -> ForecastTrial:
    """A candidate at a value, moved inside its bounds."""
    (low,), (high,) = c.bounds()
    x = float(np.clip(x, max(low, 1e-12), high))
    return ForecastTrial(c, x, exact.scores(now.with_effects(c.effect([x])), seed))


def trial_entry(s: ForecastTrial, model: mujoco.MjModel, without: float) -> dict:
    """As an effect of report.json; ``without`` is the score without it."""
    (name,), (nominal,), (unit,) = s.candidate.names, s.candidate.nominal, s.candidate.units()
    c, why = s.candidate, "what is read of the target is forecast as well with it: no clear difference"
    return {
        "effect": c.kind.name,
        "target": c.target,
        "parameters": {
            name: {
                "nominal": rounded(nominal),
                "estimate": rounded(s.x),
                "ci95": None if s.interval is None else [rounded(v) for v in s.interval],
                "unit": unit_at(model, c.target, unit),
            }
        },
        "fixed": {},
        "error_after": rounded(s.score),
        "error_without": rounded(without),
        "equivalent": [
            {"effect": e.candidate.kind.name, "target": e.candidate.target, "why": why,
             "parameters": {e.candidate.names[0]: rounded(e.x)}} for e in s.equivalent
        ],
    }  # fmt: skip

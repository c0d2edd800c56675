"""Which effect makes the source forecast best what is read of the target? Screened by states, judged by images."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from idapt_pl.diagnosis.answer.result import Alternative, EffectEstimate, ParameterEstimate
from idapt_pl.effects import Domain
from idapt_pl.effects.base import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.wording import unit_at
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.stepwise import forward_selection
from idapt_pl.image_diagnosis.forecasts import Forecaster
from idapt_pl.image_diagnosis.parabola import minimum_uncertainty, parabola_minimum

log = logging.getLogger(__name__)
NOMINAL_FACTORS = (0.4, 0.75, 1.5, 3.0, 8.0)
"""What the screen tries, of the nominal value where there is one ..."""
SCALE_MULTIPLES = (0.3, 1.0, 3.0)
"""... and scales beyond it."""
SCREENED_STARTS = 6
"""Episodes that the screen forecasts."""
FINALISTS = 6
"""Candidates that are judged by images."""
BRACKETED = 2
"""Of these, how many are looked for a better value of."""
PROMISING_SHARE = 0.03
"""Share of the score that the best of them must be worth for that, from other resets than it was chosen by."""
SEED_DISTANCE = 1000
"""Seeds so far apart share no resets: what is chosen by some is checked by others."""
FRESH_ENSEMBLES = 3
"""Ensembles of fresh resets that an effect is accepted by: one more and one less of a few differ by a tenth."""
BRACKET_STRIDE = 0.5
"""Of the logarithm of a parameter, to either side: where the lowest point is first looked for ..."""
REFINED_AT = (-0.5, -0.25, 0.25, 0.5)
"""... and where else scores are taken around it, since each is noisy."""
STANDARD_ERRORS = 3.0
"""What a gain must be worth: so many standard errors ..."""
GAIN_SHARE = 0.1
"""... and this share of the score."""


@dataclass(frozen=True)
class ForecastTrial:
    """A candidate with a value of its parameter, and what forecasts with it are worth.

    Attributes:
        candidate: an effect with one parameter.
        x: its value.
        scores: energy score of every episode, (n,).
        interval: 95 %, or None.
        equivalent: others that do as well.
    """

    candidate: Candidate
    x: float
    scores: np.ndarray
    interval: tuple[float, float] | None = None
    equivalent: tuple[ForecastTrial, ...] = ()

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
) -> tuple[tuple[ForecastTrial, ...], tuple[ForecastTrial, ...]]:
    """Effects found one after the other, and the one that came next but was not good enough (or none).

    Args:
        source: as it is now.
        candidates: effects with one parameter.
        quick: screens them.
        exact: judges.
        most: effects to find.
        seed: of resets. A gain is measured on others than an estimate was chosen by.
    """

    def step(state: tuple, taken: int) -> tuple[tuple, bool]:
        accepted, _ = state
        now = source.with_effects(*(t.effect for t in accepted))
        best = best_trial(now, candidates, quick, exact, seed)
        if best is None:
            return (accepted, ()), False
        if not surely_better(now, best, exact, seed):
            return (accepted, (best,)), False
        return ((*accepted, best), ()), True

    return forward_selection(((), ()), step, most)


def surely_better(now: Domain, trial: ForecastTrial, exact: Forecaster, seed: int) -> bool:
    """Whether forecasts from fresh resets are better with an effect, by more than chance and by enough."""
    fresh = [seed + SEED_DISTANCE * (k + 2) for k in range(FRESH_ENSEMBLES)]
    without, with_it = (np.mean([exact.scores(d, s) for s in fresh], 0) for d in (now, now.with_effects(trial.effect)))
    gain, error = paired_gain(without, with_it, np.arange(len(without)))
    log.info(
        "%s = %.4g: what is read of the target is forecast %.3g ± %.2g better than %.3g",
        trial.candidate.label, trial.x, gain, error, without.mean(),
    )  # fmt: skip
    return gain >= max(STANDARD_ERRORS * error, GAIN_SHARE * without.mean())


def best_trial(
    now: Domain, candidates: Sequence[Candidate], quick: Forecaster, exact: Forecaster, seed: int
) -> ForecastTrial | None:
    """The candidate with the best forecasts, its value refined; None where none is promising."""
    judged = [
        evaluate_at(now, t.candidate, t.x, exact, seed)
        for t in screen_by_states(now, candidates, quick, seed)[:FINALISTS]
    ]
    judged.sort(key=lambda t: t.score)
    if not judged or not is_promising(now, judged[0].effect, exact, seed + SEED_DISTANCE):
        return None
    bracketed = [bracket_minimum(now, t, exact, seed) for t in judged[:BRACKETED]]
    bracketed.sort(key=lambda tried: min(t.score for t in tried))
    best = refine_estimate(now, bracketed[0], exact, seed)
    others = [t for t in judged if t.candidate.label != best.candidate.label]
    others += [min(tried, key=lambda t: t.score) for tried in bracketed[1:]]
    equivalent = {t.candidate.label: t for t in others if indistinguishable_forecasts(best, t)}
    return replace(best, equivalent=tuple(equivalent.values()))


def screen_by_states(now: Domain, candidates: Sequence[Candidate], quick: Forecaster, seed: int) -> list[ForecastTrial]:
    """Candidates with the value that forecasts states best, the best first, without those that make it worse."""
    without = quick.scores(now, seed, SCREENED_STARTS).mean()
    best_values = []
    for c in candidates:
        tried = [
            ForecastTrial(c, x, quick.scores(now.with_effects(c.effect([x])), seed, SCREENED_STARTS))
            for x in first_values(c)
        ]
        best_values += [min(tried, key=lambda t: t.score)] if tried else []
    return sorted((t for t in best_values if t.score < without), key=lambda t: t.score)


def first_values(c: Candidate) -> list[float]:
    """Values of a candidate's parameter that are tried first; in both directions where it goes in both from 0."""
    (low,), (high,) = c.bounds()
    (nominal,), (scale,) = c.nominal, c.scale
    at = [nominal * f for f in NOMINAL_FACTORS if nominal] + [nominal + scale * f for f in SCALE_MULTIPLES]
    ahead = {float(x) for x in at if low < x <= high and x > 0 and x != nominal}
    back = {-x for x in ahead if not nominal and low <= -x}
    return sorted(ahead | back)


def indistinguishable_forecasts(best: ForecastTrial, other: ForecastTrial) -> bool:
    """Whether forecasts do not tell two candidates apart."""
    gain, error = paired_gain(other.scores, best.scores, np.arange(len(best.scores)))
    return gain < 2 * error and np.isfinite(error)


def is_promising(now: Domain, effect: Effect, exact: Forecaster, seed: int) -> bool:
    """Whether it is worth the time to look for a better value: an effect helps from other resets too."""
    without, with_it = (exact.scores(d, seed).mean() for d in (now, now.with_effects(effect)))
    return bool(with_it < (1 - PROMISING_SHARE) * without)


def bracket_minimum(now: Domain, t: ForecastTrial, exact: Forecaster, seed: int) -> list[ForecastTrial]:
    """A candidate at its first value, to either side, and where a parabola through these is lowest."""
    sides = (evaluate_at(now, t.candidate, t.x * np.exp(d), exact, seed) for d in (-BRACKET_STRIDE, BRACKET_STRIDE))
    tried = [t, *sides]
    lowest = np.copysign(np.exp(parabola_minimum(*score_curve(tried))[0]), t.x)
    return [*tried, evaluate_at(now, t.candidate, lowest, exact, seed)]


def refine_estimate(now: Domain, tried: Sequence[ForecastTrial], exact: Forecaster, seed: int) -> ForecastTrial:
    """The lowest point of a parabola through scores of values all around it, with an interval if it is among them."""
    middle, _ = parabola_minimum(*score_curve(tried))
    c, sign = tried[0].candidate, np.sign(tried[0].x)
    tried = [*tried, *(evaluate_at(now, c, sign * np.exp(middle + d), exact, seed) for d in REFINED_AT)]
    best, (middle, among) = min(tried, key=lambda t: t.score), parabola_minimum(*score_curve(tried))
    if not among:
        return best
    half = minimum_uncertainty(score_curve(tried)[0], np.stack([t.scores for t in tried]))
    low, high = sorted(sign * np.exp([middle - half, middle + half]))
    return replace(best, x=sign * np.exp(middle), interval=(low, high))


def score_curve(tried: Sequence[ForecastTrial]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the values tried (of their sizes: they have one sign), (k,), and the scores there, (k,)."""
    return np.log(np.abs([t.x for t in tried])), np.array([t.score for t in tried])


def evaluate_at(now: Domain, c: Candidate, x: float, exact: Forecaster, seed: int) -> ForecastTrial:
    """A candidate at a value, moved inside its bounds; its sign stays."""
    (low,), (high,) = c.bounds()
    x = float(np.clip(x, max(low, 1e-12), high) if x > 0 else np.clip(x, low, min(high, -1e-12)))
    return ForecastTrial(c, x, exact.scores(now.with_effects(c.effect([x])), seed))


def trial_estimate(t: ForecastTrial, model: mujoco.MjModel, without: float) -> EffectEstimate:
    """An effect of the result; ``without`` is the score without it."""
    c, why = t.candidate, "what is read of the target is forecast as well with it: no clear difference"
    (name,), (nominal,), (unit,) = c.names, c.nominal, c.units()
    interval = None if t.interval is None else (six_digits(t.interval[0]), six_digits(t.interval[1]))
    estimate = ParameterEstimate(six_digits(nominal), six_digits(t.x), interval, unit_at(model, c.target, unit))
    equivalent = (
        Alternative(e.candidate.kind.name, e.candidate.target, {e.candidate.names[0]: six_digits(e.x)}, why)
        for e in t.equivalent
    )
    scores = six_digits(t.score), six_digits(without)
    return EffectEstimate(c.kind.name, c.target, {name: estimate}, {}, *scores, tuple(equivalent))


def six_digits(x: float) -> float:
    """Rounded to six significant digits, which are enough for a file."""
    return float(f"{x:.6g}")

"""Which effect makes the source forecast best what is read of the target? Screened by states, judged by images."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.stats import t as student

from idapt_pl.diagnosis.library import Candidate
from idapt_pl.diagnosis.statistics import paired_gain
from idapt_pl.diagnosis.words import unit_at
from idapt_pl.discovery.forecasts import Forecasts
from idapt_pl.domains import Domain
from idapt_pl.domains.effects import Effect

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
"""Of these, how many get a better estimate."""
PROMISING = 0.03
"""Share of the score that the best of them must be worth for that."""
STRIDES = (0.4, 0.25)
"""Of the logarithm of a parameter, to either side: where an estimate is refined, and how scores bend there."""
SURE = 3.0
"""Standard errors that a gain must be worth ..."""
WORTH = 0.1
"""... and the share of the score."""


@dataclass
class Suspect:
    """A candidate with a value of its parameter, and what forecasts with it are worth.

    Attributes:
        candidate: an effect with one parameter.
        x: its value.
        scores: of each sighting, (n,).
        interval: 95 %, or None.
        equivalent: others that do as well.
    """

    candidate: Candidate
    x: float
    scores: np.ndarray
    interval: tuple[float, float] | None = None
    equivalent: list[Suspect] = field(default_factory=list)

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.candidate.effect([self.x])

    @property
    def score(self) -> float:
        """Mean energy score; less is better."""
        return float(self.scores.mean())


def search(
    source: Domain, candidates: Sequence[Candidate], quick: Forecasts, exact: Forecasts, most: int, seed: int
) -> tuple[list[Suspect], list[Suspect]]:
    """Effects found one after the other, and the one that came next but was not good enough (or none).

    Args:
        source: as it is now.
        candidates: effects with one parameter.
        quick: screens them.
        exact: judges.
        most: effects to find.
        seed: of resets. A gain is measured on others than an estimate was chosen by.
    """
    found: list[Suspect] = []
    while len(found) < most:
        now = source.with_effects(*(s.effect for s in found))
        best = best_of(now, candidates, quick, exact, seed)
        if best is None:
            break
        fresh = seed + 1000
        without, with_it = (exact.scores(d, fresh) for d in (now, now.with_effects(best.effect)))
        gain, error = paired_gain(without, with_it, np.arange(len(without)))
        log.info(
            "%s = %.4g: what is read of the target is forecast %.3g ± %.2g better than %.3g",
            best.candidate.label, best.x, gain, error, without.mean(),
        )  # fmt: skip
        if gain < max(SURE * error, WORTH * without.mean()):
            return found, [best]
        found.append(best)
    return found, []


def best_of(
    now: Domain, candidates: Sequence[Candidate], quick: Forecasts, exact: Forecasts, seed: int
) -> Suspect | None:
    """The candidate with the best forecasts, its value refined; None where none is promising."""
    judged = [
        Suspect(s.candidate, s.x, exact.scores(now.with_effects(s.effect), seed))
        for s in screened(now, candidates, quick, seed)[:FINALISTS]
    ]
    judged.sort(key=lambda s: s.score)
    if not judged or judged[0].score > (1 - PROMISING) * exact.scores(now, seed).mean():
        return None
    refined = [refine(now, s, exact, seed) for s in judged[:REFINED]]
    best = min(refined, key=lambda s: s.score)
    others = [s for s in judged if s.candidate.label != best.candidate.label]
    others += [s for s in refined if s is not best]
    best.equivalent = list({s.candidate.label: s for s in others if alike(best, s)}.values())
    return best


def screened(now: Domain, candidates: Sequence[Candidate], quick: Forecasts, seed: int) -> list[Suspect]:
    """Candidates with the value that forecasts states best, the best first, without those that make it worse."""
    without = quick.scores(now, seed, SCREENED).mean()
    tried = []
    for c in candidates:
        at = [Suspect(c, x, quick.scores(now.with_effects(c.effect([x])), seed, SCREENED)) for x in values(c)]
        tried += [min(at, key=lambda s: s.score)] if at else []
    return sorted((s for s in tried if s.score < without), key=lambda s: s.score)


def values(c: Candidate) -> list[float]:
    """Values of a candidate's parameter that are tried first."""
    (low,), (high,) = c.bounds()
    (nominal,), (scale,) = c.nominal, c.scale
    at = [nominal * f for f in TIMES if nominal] + [nominal + scale * f for f in SCALES]
    return sorted({float(x) for x in at if low < x <= high and x > 0 and x != nominal})


def alike(best: Suspect, other: Suspect) -> bool:
    """Whether forecasts do not tell two candidates apart."""
    gain, error = paired_gain(other.scores, best.scores, np.arange(len(best.scores)))
    return gain < 2 * error and np.isfinite(error)


def refine(now: Domain, s: Suspect, exact: Forecasts, seed: int) -> Suspect:
    """Go to the lowest point of a parabola through three scores, twice, and put an interval on it."""
    half = None
    for stride in STRIDES:
        below, above = (at(now, s.candidate, s.x * np.exp(d), exact, seed) for d in (-stride, stride))
        slope, bend = (above.score - below.score) / (2 * stride), (above.score - 2 * s.score + below.score) / stride**2
        move = np.clip(-slope / bend, -2 * stride, 2 * stride) if bend > 0 else -2 * stride * np.sign(slope)
        half = unsure(above.scores - below.scores, bend, stride)
        s = min((s, below, above, at(now, s.candidate, s.x * np.exp(move), exact, seed)), key=lambda t: t.score)
    s.interval = (s.x * np.exp(-half), s.x * np.exp(half)) if half is not None else None
    return s


def at(now: Domain, c: Candidate, x: float, exact: Forecasts, seed: int) -> Suspect:
    """A candidate at a value, moved inside its bounds."""
    (low,), (high,) = c.bounds()
    x = float(np.clip(x, max(low, 1e-12), high))
    return Suspect(c, x, exact.scores(now.with_effects(c.effect([x])), seed))


def unsure(differences: np.ndarray, bend: float, stride: float) -> float | None:
    """Half of a 95 % interval for where the mean score is lowest: how slopes of sightings differ, by its bend.

    Args:
        differences: of each sighting's scores a stride above and below, (n,).
        bend: second derivative of the mean score.
        stride: of the logarithm of the parameter.
    """
    if bend <= 0:
        return None
    n, slopes = len(differences), differences / (2 * stride)
    return float(student.ppf(0.975, n - 1) * slopes.std(ddof=1) / np.sqrt(n) / bend)


def told(s: Suspect, model: mujoco.MjModel, without: float) -> dict:
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


def rounded(x: float) -> float:
    """Six digits are enough."""
    return float(f"{x:.6g}")

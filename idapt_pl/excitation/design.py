"""The search for a motion: random ones, then CMA-ES around the best; safe ones always go before others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cma
import numpy as np

from idapt_pl.diagnosis.state.context import Progress
from idapt_pl.estimation.intervals import deviations_from
from idapt_pl.excitation.criterion import Score, SeparationCriterion
from idapt_pl.excitation.forecast import Forecast, coarse
from idapt_pl.excitation.limits import ImpossibleMotion, MotionLimits
from idapt_pl.excitation.motion import FourierMotion
from idapt_pl.excitation.safety import PoseCheck, SafetyMargin, limit_margins, motion_excess, relative_size
from idapt_pl.excitation.variants import varied

POPULATION = 16
"""Motions that are simulated together."""

SEPARATED = 1.5
"""Standard deviations of one play from which two explanations count as told apart: twenty plays do it then."""

HALF_WORTH = 3.0
"""Standard deviations that are worth half; pairs below get a search of their own."""

VARIANTS = 3
"""Models with other friction, masses and strengths in which a motion must be safe, for every explanation."""

FULL = 0.95
"""Share of the limits that a motion may take up in the leading explanation; the others need some room."""

SHRINK = 0.85
"""Factor on the motion's size while it is not safe in these."""


class Goal(StrEnum):
    """What a motion is for."""

    SEPARATE = "separate"
    """Tell explanations apart."""
    ESTIMATE = "estimate"
    """Narrow the intervals of what was found, all at once (D-optimal: the determinant of Fisher's information)."""
    ESTIMATE_EACH = "estimate-each"
    """The same one by one (A-optimal: the sum of the variances)."""


@dataclass(frozen=True)
class MotionDesign:
    """A motion and what it does.

    Attributes:
        commands: (T, nu).
        separations: of every pair of rivals, each fitted again to what the other predicts, standard deviations.
        reachable: the greatest separation of every pair that any safe motion tried would give, by the linear number.
        deviations: standard deviations that the motion alone leaves of the first rival's parameters, in their units;
            infinite where it does not show them.
        margins: the tightest places over all explanations and their variants.
        forecasts: of each rival.
        growth: ends of windows, s, (w,), and how much every pair is separated until then, (pairs, w).
        tried: how many motions were simulated.
        safe: how many of them kept the limits.
    """

    commands: np.ndarray
    separations: np.ndarray
    reachable: np.ndarray
    deviations: np.ndarray
    margins: Sequence[SafetyMargin]
    forecasts: Sequence[Forecast]
    growth: tuple[np.ndarray, np.ndarray]
    tried: int
    safe: int


@dataclass(frozen=True)
class Best:
    """The best motion so far.

    Attributes:
        x: its coefficients.
        value: what it is worth; minus its excess over the limits where it is not safe.
        separations: of every pair.
    """

    x: np.ndarray
    value: float
    separations: np.ndarray


class MotionSearch:
    """Searches coefficients of a series.

    Args:
        criterion: scores commands.
        motion: makes them from coefficients.
        limits: that they must keep.
        goal: what they are for.
        seed: of all random choices.
        progress: told how far it is.
    """

    def __init__(
        self, criterion: SeparationCriterion, motion: FourierMotion, limits: MotionLimits, goal: Goal, seed: int,
        progress: Progress,
    ) -> None:  # fmt: skip
        self.criterion, self.motion, self.limits, self.goal = criterion, motion, limits, goal
        self.seed, self.rng, self.progress = seed, np.random.default_rng(seed), progress
        self.reachable = np.zeros(len(criterion.pairs))
        self.tried = self.safe = 0
        self.checks = [PoseCheck(criterion.forecast.sim.compile(coarse(r)), limits) for r in criterion.rivals]

    def run(self, evaluations: int) -> MotionDesign:
        """Search with so many simulated motions.

        Raises:
            ImpossibleMotion: no motion keeps the limits.
        """
        first = self.motion.random(self.rng, POPULATION)
        self.criterion.calibrate(self.motion.commands(0.3 * first))
        scattered, own = max(POPULATION, evaluations // 3), self.worth
        best = self.at_random(scattered, own, "trying motions", (0.0, 0.3))
        if best.value < 0:
            best = self.made_smaller(best)
        self.criterion.calibrate(self.motion.commands(best.x[None]))
        best = self.refined(replace(best, value=-np.inf), evaluations - scattered, own, "refining", (0.3, 0.75))
        if self.goal is Goal.SEPARATE:
            best = self.try_hard_pairs(best, evaluations // 4)
        return self.finished(best)

    def worth(self, score: Score) -> np.ndarray:
        """What safe motions are worth, (n,), above 0."""
        if self.goal is Goal.SEPARATE:
            return (score.separations / (score.separations + HALF_WORTH)).mean(1)
        if self.goal is Goal.ESTIMATE_EACH:
            return np.array([narrowness(F) for F in score.information])
        F = score.information + 1e-9 * np.eye(score.information.shape[-1])
        return np.exp(np.linalg.slogdet(F)[1] / F.shape[-1] / 2)

    def values(self, x: np.ndarray, worth: Callable[[Score], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Values of coefficients (n, size): the worth of safe motions, minus the excess of others; and separations."""
        commands = self.motion.commands(x)
        score = self.criterion(commands)
        excess = np.stack([self.excess(i, f) for i, f in enumerate(score.forecasts)]).max(0)
        safe = excess <= 0
        self.tried, self.safe = self.tried + len(x), self.safe + int(safe.sum())
        if safe.any():
            self.reachable = np.maximum(self.reachable, score.separations[safe].max(0, initial=0.0))
        return np.where(safe, worth(score), -np.maximum(excess, 1e-9)), score.separations

    def enlarged(self, x: np.ndarray) -> np.ndarray:
        """Coefficients (n, size) of the same motions made as large as limits and commands allow."""
        for _ in range(4):
            x = self.fitted(2 * np.array([self.motion.reachable(v) for v in x]))
        return x

    def fitted(self, x: np.ndarray) -> np.ndarray:
        """Coefficients of the same motions, those that are too large for the limits made smaller, (n, size)."""
        seen = self.criterion.forecast(coarse(self.criterion.rivals[0]), self.motion.commands(x))
        size = relative_size(self.criterion.forecast.model, self.limits, seen.qpos, seen.qvel) / FULL
        return np.array([self.motion.reachable(v) / s if s > 1 else v for v, s in zip(x, size, strict=True)])

    def excess(self, rival: int, seen: Forecast) -> np.ndarray:
        """By how much motions go beyond the limits under one rival, (n,); not above 0 for safe ones."""
        excess = motion_excess(self.criterion.forecast.model, self.limits, seen.qpos, seen.qvel)
        check = self.checks[rival]
        for k in np.flatnonzero(excess <= 0) if check.needed else ():
            rooms = [m.room for m in check.forbidden(seen.states[k], seen.arriving[k])]
            excess[k] = max(excess[k], -min(rooms, default=0.0))
        return excess

    def at_random(self, n: int, worth: Callable[[Score], np.ndarray], what: str, span: tuple[float, float]) -> Best:
        """The best of so many random motions."""
        best = Best(np.zeros(self.motion.size), -np.inf, np.zeros(len(self.criterion.pairs)))
        for k in range(0, n, POPULATION):
            self.progress(what, span[0] + (span[1] - span[0]) * k / n)
            best = self.better(best, self.motion.random(self.rng, POPULATION), worth)
        return best

    def better(self, best: Best, x: np.ndarray, worth: Callable[[Score], np.ndarray]) -> Best:
        """The best of some motions and the best so far."""
        x = self.fitted(x)
        values, separations = self.values(x, worth)
        k = int(np.argmax(values))
        return Best(x[k], float(values[k]), separations[k]) if values[k] > best.value else best

    def made_smaller(self, best: Best) -> Best:
        """A safe motion out of one that is not, by making it smaller.

        Raises:
            ImpossibleMotion: even a very small one is not safe.
        """
        x = self.motion.reachable(best.x)[None] * 0.5 ** np.arange(1, 9)[:, None]
        found = self.better(replace(best, value=-np.inf), x, self.worth)
        if found.value < 0:
            raise ImpossibleMotion(
                "the limits allow no motion: even a very small one breaks them "
                f"({self.worst_margin(found.x)}); widen them, or give another --start"
            )
        return found

    def worst_margin(self, x: np.ndarray) -> str:
        """In words where a motion breaks the limits."""
        margins = self.margins_of(self.criterion(self.motion.commands(x[None])).forecasts)
        worst = min(margins, key=lambda m: m.room)
        return f"{worst.what} reaches {worst.reached:.3g}, the limit is {worst.limit:.3g}"

    def margins_of(self, forecasts: Sequence[Forecast]) -> list[SafetyMargin]:
        """The tightest places over the rivals' forecasts of one motion."""
        pairs = zip(self.checks, forecasts, strict=True)
        return tightest_of_each([m for check, seen in pairs for m in self.margins(check, seen)])

    def margins(self, check: PoseCheck, seen: Forecast) -> list[SafetyMargin]:
        """The tightest places of one motion, by the model that it was forecast with."""
        speeds = limit_margins(self.criterion.forecast.model, self.limits, seen.qpos[0], seen.qvel[0])
        return [*speeds, *check.forbidden(seen.states[0], seen.arriving[0])]

    def refined(
        self, best: Best, n: int, worth: Callable[[Score], np.ndarray], what: str, span: tuple[float, float]
    ) -> Best:
        """CMA-ES (Hansen & Ostermeier 2001) around the best so far, with so many motions."""
        options = {
            "seed": self.seed + 1, "popsize": POPULATION, "verbose": -9, "CMA_diagonal": self.motion.size > 30,
            "verb_log": 0,
        }  # fmt: skip
        search = cma.CMAEvolutionStrategy(best.x, 0.15, options)
        best = self.better(best, best.x[None], worth)
        for k in range(0, n, POPULATION):
            self.progress(what, span[0] + (span[1] - span[0]) * k / n)
            asked = np.array(search.ask())
            x = self.fitted(asked)
            values, separations = self.values(x, worth)
            search.tell(list(asked), list(-values))
            i = int(np.argmax(values))
            if values[i] > best.value:
                best = Best(x[i], float(values[i]), separations[i])
        return best

    def try_hard_pairs(self, best: Best, n: int) -> Best:
        """Search once more for each pair that nothing has told apart; take what it finds if it is better in all."""
        hard = np.flatnonzero(self.reachable < HALF_WORTH)
        for i, pair in enumerate(hard):
            span = (0.75 + 0.15 * i / len(hard), 0.75 + 0.15 * (i + 1) / len(hard))
            found = self.refined(
                replace(best, value=-np.inf), max(POPULATION, n // len(hard)), of_pair(int(pair)), "hard pairs", span
            )
            best = self.better(best, found.x[None], self.worth)
        return best

    def finished(self, best: Best) -> MotionDesign:
        """The motion made safe in all variants, and what it does, without shortcuts."""
        forecast = self.criterion.forecast
        self.progress("checking safety", 0.9)
        commands, margins = self.made_safe(best.x)
        self.progress("judging", 0.95)
        separations = self.criterion.after_refit(commands[0])
        self.reachable = np.maximum(self.reachable, separations)
        F = self.criterion(commands).information[0]
        scale = np.concatenate([c.scale for c in self.criterion.rivals[0].candidates])
        deviations = deviations_from(F) * scale
        forecasts = [forecast(r.effects, commands) for r in self.criterion.rivals]
        self.progress("done", 1.0)
        return MotionDesign(
            commands[0], separations, self.reachable, deviations, margins, forecasts, self.criterion.growth(commands),
            self.tried, self.safe,
        )  # fmt: skip

    def made_safe(self, x: np.ndarray) -> tuple[np.ndarray, list[SafetyMargin]]:
        """Commands (1, T, nu) of a motion made so small that it is safe in all variants, and its margins.

        Raises:
            ImpossibleMotion: it is not safe however small.
        """
        margins: list[SafetyMargin] = []
        for _ in range(20):
            commands = self.motion.commands(x[None])
            margins = self.margins_with_variants(commands)
            if all(m.room >= 0 for m in margins):
                return commands, margins
            x = SHRINK * self.motion.reachable(x)
        worst = min(margins, key=lambda m: m.room)
        raise ImpossibleMotion(
            f"the limits allow no motion: {worst.what} reaches {worst.reached:.3g} where friction, masses or "
            f"actuators differ a little (limit {worst.limit:.3g}); widen the limits"
        )

    def margins_with_variants(self, commands: np.ndarray) -> list[SafetyMargin]:
        """The tightest places of a motion (1, T, nu) over all rivals, and over variants of each."""
        forecast, rng, found = self.criterion.forecast, np.random.default_rng(self.seed), []
        for effects in map(coarse, self.criterion.rivals):
            model, start = forecast.sim.compile(effects), forecast.start(effects)
            for variant in (effects, *(varied(model, effects, rng) for _ in range(VARIANTS))):
                check = PoseCheck(forecast.sim.compile(variant), self.limits)
                found += self.margins(check, forecast(variant, commands, start))
        return tightest_of_each(found)


def narrowness(information: np.ndarray) -> float:
    """How many parameters a motion shows, and below 1 how narrow these get, by Fisher's information (p, p).

    A parameter that no motion shows must not hide how well they show the others.
    """
    deviations = deviations_from(information)
    shown = deviations[np.isfinite(deviations)]
    return len(shown) + float(1 / (1 + np.linalg.norm(shown)))


def of_pair(pair: int) -> Callable[[Score], np.ndarray]:
    """Worth of motions where a single pair counts."""
    return lambda score: score.separations[:, pair]


def tightest_of_each(margins: Sequence[SafetyMargin]) -> list[SafetyMargin]:
    """The least room in every respect."""
    found: dict[str, SafetyMargin] = {}
    for m in margins:
        if m.what not in found or m.room < found[m.what].room:
            found[m.what] = m
    return list(found.values())

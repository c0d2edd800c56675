"""The screen: every candidate is switched on slightly, and scored by how much of the residual that explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idapt_pl.diagnosis.search_state import Search, Trial, WhitenedWindows
from idapt_pl.diagnosis.simulator import Effects
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.wording import format_number
from idapt_pl.estimation.least_squares import HUBER

DERIVATIVE_STEP = 0.05
"""How slightly: share of a candidate's scale."""


def screen_candidates(search: Search, round: int) -> list[Trial]:
    """Score all candidates on few windows and the best again on more; best first."""
    scout, known = ScoreTest(search, search.scout, search.sketch), {(c.label, c.names) for c in search.accepted}
    tried = [scout.score(c, c.starts, round) for c in search.candidates if (c.label, c.names) not in known]
    tried.sort(key=lambda t: -penalised_score(t))
    best, rest = tried[: search.settings.screened], tried[search.settings.screened :]
    screen = ScoreTest(search, search.screen, search.z)
    best = [screen.score(t.candidate, t.x, round) for t in best]
    ratio = len(search.screen.windows) / len(search.scout.windows)
    for t in rest:
        t.score *= ratio
    return sorted(best, key=lambda t: -penalised_score(t)) + rest


def penalised_score(t: Trial) -> float:
    """What ranks a candidate: its score, less what as many parameters would gain by chance."""
    return t.score - 2 * t.candidate.size


def shortlist(ranked: list[Trial], size: int) -> list[Trial]:
    """The best ``size``, and the best of every other kind that scores a tenth of it: scores are only linear."""
    chosen = [t for t in ranked[:size] if not t.rejected_because]
    kinds = {t.candidate.kind for t in chosen}
    for t in ranked[size:]:
        if t.candidate.kind not in kinds and t.score > 0.1 * ranked[0].score and not t.rejected_because:
            chosen.append(t)
            kinds.add(t.candidate.kind)
    return chosen


class ScoreTest:
    """Scores on one split: the Lagrange-multiplier test, after projecting out what is accepted."""

    def __init__(
        self, search: Search, split: WhitenedWindows, predict: Callable[[WhitenedWindows, Effects], np.ndarray]
    ) -> None:
        self.search, self.predict = search, lambda e: predict(split, e)
        z, self.base = search.z(split, search.effects), self.predict(search.effects)
        self.root = np.sqrt(1.0 / np.maximum(1.0, np.abs(z.ravel()) / HUBER))[:, None]
        accepted = [self.derivative(c, x, k) for k, (c, x) in enumerate(zip(search.accepted, search.x, strict=True))]
        D = np.concatenate(accepted, 1) * self.root if accepted else np.zeros((z.size, 0))
        self.Q = np.linalg.qr(D)[0]
        self.left = self.clear(z.reshape(-1, 1))[:, 0]
        self.total = float(self.left @ self.left)
        self.variance = max(1.0, self.total / z.size)

    def clear(self, v: np.ndarray) -> np.ndarray:
        """Weighted rows, orthogonal to what is accepted."""
        v = v * self.root
        return v - self.Q @ (self.Q.T @ v)

    def derivative(self, c: Candidate, x: np.ndarray, accepted: int | None = None) -> np.ndarray:
        """D z / d (x / scale) on top of the current model (of the accepted effect with that number), (rows, p)."""
        effects, (_, high), columns = self.search.effects, c.bounds(), []
        if accepted is not None:
            own = len(self.search.fixed) + accepted
            effects = effects[:own] + effects[own + 1 :]
        for k in range(c.size):
            moved, sign = np.array(x, float), 1.0 if x[k] + DERIVATIVE_STEP * c.scale[k] <= high[k] else -1.0
            moved[k] += sign * DERIVATIVE_STEP * c.scale[k]
            z = self.predict((*effects, c.effect(moved)))
            columns.append((z - self.base).ravel() / (sign * DERIVATIVE_STEP))
        return np.stack(columns, 1)

    def score(self, c: Candidate, starts: Sequence[np.ndarray], round: int) -> Trial:
        """The better of a linear step from nominal and of the given places to start a fit from."""
        nominal = np.array(c.nominal)
        D = self.clear(self.derivative(c, nominal))
        x, gain = best_step(D, self.left, nominal, np.array(c.scale), *c.bounds())
        norm = np.linalg.norm(D, axis=0)
        for s in starts:
            z = self.predict((*self.search.effects, c.effect(s)))
            secant = self.clear((z - self.base).reshape(-1, 1))[:, 0]
            size = float(secant @ secant)
            norm = np.maximum(norm, np.sqrt(size) * (np.abs(np.subtract(s, nominal)) > 0) / 10)
            removed = self.total - float(np.square(self.left + secant).sum())
            if size > 1e-12 and removed > gain:
                gain, x = removed, np.array(s, float)
        return Trial(c, round, gain / self.variance, (x,), rejected_because=self.objection(c, gain, norm))

    def objection(self, c: Candidate, gain: float, norm: np.ndarray) -> str:
        """Why a score is not worth a refit, or nothing. ``norm``: of what a change by the scale does, in sigma."""
        z, score = self.search.settings.z, gain / self.variance
        if (10 * norm < z).all():
            k = int(np.argmax(norm))
            change = f"{format_number(z * c.scale[k] / norm[k])} {c.units()[k]}" if norm[k] > 1e-9 else "any size"
            return f"not excited by these recordings: a change of its {c.names[k]} by {change} would go unseen"
        return f"score {score:.1f} is what noise alone gives" if score < z**2 + 2 * c.size else ""


def best_step(
    D: np.ndarray, left: np.ndarray, nominal: np.ndarray, scale: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """The least-squares step of a linear candidate inside its bounds, and how much squared error it removes."""
    H = D.T @ D
    step = -np.linalg.lstsq(H + 1e-9 * np.trace(H) * np.eye(len(H)) + 1e-300, D.T @ left, rcond=None)[0]
    x = np.clip(nominal + np.clip(step, -10, 10) * scale, low, high)
    moved = D @ ((x - nominal) / scale)
    return x, float(np.square(left).sum() - np.square(left + moved).sum())

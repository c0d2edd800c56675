"""The screen: every candidate is switched on slightly, and scored by how much of the residual that explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import parameter_box
from idapt_pl.diagnosis.candidates.periodogram import periodic_starts
from idapt_pl.diagnosis.candidates.responses import Responses
from idapt_pl.diagnosis.candidates.trial import Rejection, RejectionReason, Trial
from idapt_pl.diagnosis.rounds.force_look import acts_as_force, has_play, responses_by_forces
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.base import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointCogging
from idapt_pl.effects.wording import format_number
from idapt_pl.estimation.least_squares import ParameterBox, huber_weights, kept_in_line, project_out
from idapt_pl.prediction.force_windows import NO_SAY, judges_forces
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import WhitenedWindows, whiten

DERIVATIVE_STEP = 0.05
"""How slightly: share of a candidate's scale."""

MANY, SIMULATED, SAMPLED = 250, 40, 16
"""Candidates above which they are ordered by forces first; of the best, and of the others, so many are simulated."""

MISSED = 0.1
"""Share of the best score that one of the others may have, if the order by forces is to be believed."""

LONGEST_LINEAR_STEP = 10.0
"""Scales that the screen believes a linear prediction for."""


def screen_candidates(
    context: SearchContext, state: SearchState, round: int, as_seen_before: bool = False
) -> list[Trial]:
    """Score all candidates on few windows and the best again on more; best first.

    Args:
        context: of the search.
        state: the current model.
        round: of the search.
        as_seen_before: for the first look take what candidates change under whatever model that was simulated.
    """
    step = context.coarse_step(state.windows.scout, state.effects)
    kept = context.responses
    scout = ScoreTest(context, state, state.windows.scout, step, kept, as_seen_before)
    known = {(c.label, c.names) for c in state.candidates}
    silent = NO_SAY if judges_forces(state.windows.scout) else ()
    considered = [
        c for c in context.candidates if (c.label, c.names) not in known and not (silent and issubclass(c.kind, silent))
    ]

    def simulate(c: Candidate) -> Trial:
        return scout.score(c, starts_of(context, scout, state.windows.scout, c), round)

    many = len(considered) > MANY and not has_play(state) and not judges_forces(state.windows.scout)
    each = context.sim.side_by_side.map
    trials = simulate_the_best(context, state, considered, simulate) if many else each(simulate, considered)
    trials.sort(key=penalised_score, reverse=True)
    best, rest = trials[: context.settings.screened], trials[context.settings.screened :]
    screen = ScoreTest(context, state, state.windows.screen, context.coarse_step(state.windows.screen, state.effects))
    best = each(lambda t: screen.score(t.candidate, t.x, round), best)
    ratio = len(state.windows.screen.windows) / len(state.windows.scout.windows)
    rest = [replace(t, score=t.score * ratio) for t in rest]
    return sorted(best, key=penalised_score, reverse=True) + rest


def simulate_the_best(
    context: SearchContext, state: SearchState, candidates: Sequence[Candidate], simulate: Callable[[Candidate], Trial]
) -> list[Trial]:
    """Trials of many candidates: the best by forces are simulated, others have rough scores.

    Some of the others are simulated too. Where one of these scores high, forces do not tell the order, as where feet
    strike the ground, and all are simulated.
    """
    split = state.windows.scout
    test = ScoreTest(context, state, split, respond=responses_by_forces(context, state, split))
    rough = {c: test.score(c, starts_of(context, test, split, c), 0) for c in candidates if acts_as_force(c)}
    order = sorted(rough, key=lambda c: -penalised_score(rough[c]))
    best, rest = order[:SIMULATED], order[SIMULATED:]
    sample = rest[:: max(1, len(rest) // SAMPLED)]
    each = context.sim.side_by_side.map
    trials = each(simulate, [c for c in candidates if c in best or not acts_as_force(c)])
    drawn = each(simulate, sample)
    if max((t.score for t in drawn), default=0.0) > MISSED * max(t.score for t in trials):
        return each(simulate, candidates)
    return [*trials, *drawn, *(replace(rough[c], round=trials[0].round) for c in rest if c not in sample)]


def starts_of(
    context: SearchContext, test: ScoreTest, split: WhitenedWindows, c: Candidate
) -> Sequence[tuple[float, ...]]:
    """Places to start a fit from: those of the candidate, or what the residual says of a torque that repeats."""
    if c.kind is not JointCogging or judges_forces(split):
        return c.starts
    return periodic_starts(context.sim, split.windows, c, test.left, test.change)


def penalised_score(t: Trial) -> float:
    """What ranks a candidate: its score, less what as many parameters would gain by chance."""
    return t.score - 2 * t.candidate.size


def shortlist(ranked: list[Trial], size: int) -> list[Trial]:
    """The best ``size``, and the best of every other kind that scores a tenth of it: scores are only linear."""
    chosen = [t for t in ranked[:size] if not t.rejection]
    kinds = {t.candidate.kind for t in chosen}
    for t in ranked[size:]:
        if t.candidate.kind not in kinds and t.score > 0.1 * ranked[0].score and not t.rejection:
            chosen.append(t)
            kinds.add(t.candidate.kind)
    return chosen


class ScoreTest:
    """Scores of candidates: the Lagrange-multiplier (Rao's score) test, after projecting out what is accepted.

    Args:
        context: of the search.
        state: the current model.
        split: windows to score on.
        step: longest time step with which to simulate what candidates change; default (0) is the model's, as found.
        kept: responses of earlier looks, that count where the model has moved little since.
        any_model: or if that was under whatever model.
        respond: what an effect changes in whitened residuals, (n, rows); default is to simulate it.
    """

    def __init__(
        self, context: SearchContext, state: SearchState, split: WhitenedWindows, step: float = 0.0,
        kept: Responses | None = None, any_model: bool = False, respond: Callable[[Effect], np.ndarray] | None = None,
    ) -> None:  # fmt: skip
        self.settings, self.state, self.split, self.respond = context.settings, state, split, respond
        self.residual: Callable[[Effects], np.ndarray] = lambda e: split.unwhitened(
            context.sim, context.with_coarse_numerics(e, step)
        )
        z, self.base = context.whitened(split, state.effects), self.residual(state.effects)
        self.responses = (kept or Responses()).under(split, self.base, any_model)
        self.root = np.sqrt(huber_weights(z.ravel()))[:, None]
        accepted = context.sim.side_by_side.map(
            lambda k: self.derivative(state.candidates[k], state.estimates[k], k), range(len(state.accepted))
        )
        D = np.concatenate(accepted, 1) * self.root if accepted else np.zeros((z.size, 0))
        self.Q = np.linalg.qr(D)[0]
        self.left = self.clear(z.reshape(-1, 1))[:, 0]
        self.total = float(self.left @ self.left)
        self.variance = max(1.0, self.total / z.size)

    def clear(self, v: np.ndarray) -> np.ndarray:
        """Weighted rows (rows, k), orthogonal to what is accepted."""
        return project_out(self.Q, v * self.root)

    def change(self, effect: Effect) -> np.ndarray:
        """What an effect changes in the weighted residual on top of the current model, (rows,)."""
        return self.clear(self.response(effect).reshape(-1, 1))[:, 0]

    def change_now(self, effect: Effect) -> np.ndarray:
        """The same, simulated under this very model."""
        return self.clear(self.response_now(effect).reshape(-1, 1))[:, 0]

    def response(self, effect: Effect) -> np.ndarray:
        """What an effect changes in the whitened residual on top of the current model, (rows,)."""
        if self.respond is not None:
            return self.respond(effect).ravel()
        effects = (*self.state.effects, effect)
        return self.responses.get(effect, lambda: self.residual(effects) - self.base).ravel()

    def response_now(self, effect: Effect) -> np.ndarray:
        """The same, simulated under this very model."""
        if self.respond is not None:
            return self.respond(effect).ravel()
        return whiten(self.split.W, self.residual((*self.state.effects, effect)) - self.base).ravel()

    def standing(self, c: Candidate) -> tuple[np.ndarray, np.ndarray | None]:
        """Where a search for a candidate begins, (p,), and what it changes there already, (rows,) or nothing.

        That is its nominal value, and nothing. But where an accepted effect has given its element another value, the
        candidate takes that back: then it begins from whichever of the two changes less.
        """
        nominal = np.array(c.nominal)
        places = [nominal, *(a.x for a in self.state.accepted if a.candidate.overlaps(c))]
        if len(places) == 1:
            return nominal, None
        changes = [self.response_now(c.effect(x)) for x in places]
        least = int(np.argmin([np.linalg.norm(change) for change in changes]))
        return places[least], changes[least]

    def derivative(
        self, c: Candidate, x: np.ndarray, accepted: int | None = None, at_x: np.ndarray | None = None
    ) -> np.ndarray:
        """D z / d (x / scale) on top of the current model (of the accepted effect with that number), (rows, p).

        ``at_x`` is what the candidate changes at x already, (rows,), if it does.
        """
        effects, (_, high), columns = self.state.effects, c.bounds(), []
        for k in range(c.size):
            moved, sign = np.array(x, float), 1.0 if x[k] + DERIVATIVE_STEP * c.scale[k] <= high[k] else -1.0
            moved[k] += sign * DERIVATIVE_STEP * c.scale[k]
            if accepted is None:
                effect = c.effect(moved)
                change = self.response(effect) if at_x is None else self.response_now(effect) - at_x
            else:
                own = len(self.state.fixed) + accepted
                others = (*effects[:own], *effects[own + 1 :], c.effect(moved))
                change = whiten(self.split.W, self.residual(others) - self.base).ravel()
            columns.append(change / (sign * DERIVATIVE_STEP))
        return np.stack(columns, 1)

    def score(self, c: Candidate, starts: Sequence[np.ndarray | tuple[float, ...]], round: int) -> Trial:
        """The better of a linear step from where it changes nothing, and of given places to start a fit from.

        Near its nominal value a limit may change nothing at all. Then a place beyond the right one counts by the share
        of its change that explains most.
        """
        begin, change = self.standing(c)
        D = self.clear(kept_in_line(self.derivative(c, begin, at_x=change), len(self.split.windows)))
        left = self.left if change is None else self.left + self.clear(change.reshape(-1, 1))[:, 0]
        x, gain = linear_step(D, left, begin, parameter_box([c]))
        gain += self.total - float(left @ left)
        norm = np.linalg.norm(D, axis=0)
        for s in starts:
            secant = (self.change if change is None else self.change_now)(c.effect(s))
            secant = kept_in_line(secant[:, None], len(self.split.windows))[:, 0]
            size = float(secant @ secant)
            norm = np.maximum(norm, np.sqrt(size) * (np.abs(np.subtract(s, begin)) > 0) / 10)
            share = 1.0 if D.any() or not size else float(np.clip(-self.left @ secant / size, 0.0, 1.0))
            removed = self.total - float(np.square(self.left + share * secant).sum())
            if size > 1e-12 and removed > gain:
                gain, x = removed, np.array(s, float)
        return Trial(c, round, gain / self.variance, (x,), rejection=self.objection(c, gain, norm))

    def objection(self, c: Candidate, gain: float, norm: np.ndarray) -> Rejection | None:
        """Why a score is not worth a refit, if it is not.

        Args:
            c: the candidate.
            gain: squared error that it removes.
            norm: of what a change of each parameter by its scale does, in sigma, (p,).
        """
        z, score = self.settings.z, gain / self.variance
        if (10 * norm < z).all():
            k = int(np.argmax(norm))
            change = f"{format_number(z * c.scale[k] / norm[k])} {c.units()[k]}" if norm[k] > 1e-9 else "any size"
            text = f"not excited by these recordings: a change of its {c.names[k]} by {change} would go unseen"
            return Rejection(RejectionReason.NOT_EXCITED, text)
        if score < z**2 + 2 * c.size:
            return Rejection(RejectionReason.CHANCE, f"score {score:.1f} is what noise alone gives")
        return None


def linear_step(D: np.ndarray, left: np.ndarray, nominal: np.ndarray, box: ParameterBox) -> tuple[np.ndarray, float]:
    """The least-squares step of a linear candidate, inside its bounds.

    Args:
        D: d z / d (x / scale), (rows, p).
        left: whitened residuals, (rows,).
        nominal: where the step begins, (p,).
        box: scales and bounds.

    Returns:
        Where it leads, (p,), and how much squared error it removes.
    """
    H = D.T @ D
    step = -np.linalg.lstsq(H + 1e-9 * np.trace(H) * np.eye(len(H)) + 1e-300, D.T @ left, rcond=None)[0]
    x = box.step(nominal, step, LONGEST_LINEAR_STEP)
    moved = D @ ((x - nominal) / box.scale)
    return x, float(np.square(left).sum() - np.square(left + moved).sum())

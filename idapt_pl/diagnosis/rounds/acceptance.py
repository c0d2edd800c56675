"""Confirm and accept: refit what the screen proposes, judge it on held-out episodes, take the best."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import WhitenedResidual, effects_of, fit_candidates
from idapt_pl.diagnosis.candidates.trial import RejectionReason, Trial
from idapt_pl.diagnosis.rounds.both_ways import gain_on_all
from idapt_pl.diagnosis.rounds.gates import Judged, objection
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, slopes_of_accepted
from idapt_pl.effects.base import ACTUATED
from idapt_pl.effects.plausible import rarity
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)
STEPS, FIRST_STEPS = 5, 2
"""Of a fit with a candidate, and of these before those far behind are left."""
IN_THE_RACE = 0.7
"""Share of the way from the best candidate's loss to that without any, beyond which one is far behind."""
FAR_LOSS = 10.0
"""Held-out loss above which the best single effect is surely not all that is missing."""
PARSIMONY = 0.15
"""Share of the best gain that every further parameter must then be worth."""


def confirm(context: SearchContext, state: SearchState, chosen: Sequence[Trial]) -> list[Trial]:
    """Refit candidates, the best of them without shortcuts, and see what these are worth on held-out episodes.

    Returns:
        Their trials, by what they leave on few windows and their parameters, the least first; most of them rejected.
    """
    rough = rough_fits(context, state, chosen)
    slopes = slopes_of_accepted(context, state, state.windows.screen)
    without = float(context.loss(state.windows.scout, state.effects).mean())
    now = context.loss(state.windows.held_out, state.effects)
    best = min((t.rough_loss for t in rough), default=without)
    near = [t for t in rough if t.rough_loss <= best + 0.4 * max(without - best, 0.0)][: context.settings.refined]
    confirmed = context.sim.side_by_side.map(lambda t: refine(context, state, t, slopes, now), near)

    def left(t: Trial) -> Trial:
        text = f"refitted, it leaves {t.rough_loss:.3g}; {rough[0].candidate.label} leaves {best:.3g}"
        return t.rejected(RejectionReason.POOR_FIT, text)

    return [*confirmed, *(left(t) for t in rough if t not in near)]


def rough_fits(
    context: SearchContext, state: SearchState, chosen: Sequence[Trial], good_enough: float = np.inf
) -> list[Trial]:
    """Refit candidates, with all accepted effects free, on few windows, best first.

    What every parameter gains by chance does not count (Akaike 1974): of those that do the same the simplest are first.
    After some steps those that are far behind are left as they are, and so are those that would not come to a mean
    loss of ``good_enough``.
    """
    slopes = slopes_of_accepted(context, state, state.windows.scout)
    without = float(context.loss(state.windows.scout, state.effects).mean())
    residual, each = context.about(state.windows.scout, state.effects), context.sim.side_by_side.map

    def begin(t: Trial) -> tuple[Trial, np.ndarray]:
        return rough_fit(residual, state, replace(t, x=(*state.estimates, t.x[-1])), FIRST_STEPS, slopes, good_enough)

    begun = each(begin, chosen)
    best = min((t.rough_loss for t, _ in begun), default=without)
    near = best + IN_THE_RACE * max(without - best, 0.0)

    def go_on(t_and_slopes: tuple[Trial, np.ndarray]) -> Trial:
        t, J = t_and_slopes
        return rough_fit(residual, state, t, STEPS - FIRST_STEPS, J, good_enough)[0] if t.rough_loss <= near else t

    by_chance = 2 / len(slopes)  # of the loss, by each parameter
    return sorted(each(go_on, begun), key=lambda t: t.rough_loss * (1 + by_chance * t.candidate.size))


def rough_fit(
    residual: WhitenedResidual, state: SearchState, t: Trial, steps: int, slopes: np.ndarray, good_enough: float
) -> tuple[Trial, np.ndarray]:
    """Some steps from where a trial is; ``slopes`` by the first parameters. With the slopes by all where it ended."""
    candidates = [*state.candidates, t.candidate]
    fit = fit_candidates(residual, state.fixed, candidates, t.x, steps, slopes=slopes, good_enough=good_enough)
    return replace(t, x=fit.x, rough_loss=fit.solution.loss), fit.solution.J


def refine(context: SearchContext, state: SearchState, t: Trial, slopes: np.ndarray, now: np.ndarray) -> Trial:
    """Refit a candidate, with all accepted effects free, and judge it.

    Args:
        context: of the search.
        state: the current model.
        t: the candidate, roughly fitted.
        slopes: by what was accepted, (n rows, p).
        now: held-out losses without it, (n,).
    """
    candidates = [*state.candidates, t.candidate]
    x = context.fit(state.windows.screen, state.fixed, candidates, t.x, STEPS, slopes=slopes).x
    losses = context.loss(state.windows.held_out, (*state.fixed, *effects_of(candidates, x)))
    gain, error = gain_on_all(
        context, state, candidates, x, state.effects, (now, losses), sure=context.settings.sureness
    )
    judged = Judged(t.candidate, x[-1], gain, error, float(now.mean()), bool(state.accepted), context.settings)
    return replace(t, x=x, losses=losses, gain=gain, gain_error=error, rejection=objection(judged))


def accept(state: SearchState, trials: Sequence[Trial]) -> tuple[SearchState | None, list[Trial]]:
    """The best of those that passed: fewest parameters among those that are as good as the best.

    Args:
        state: the current model.
        trials: of :func:`confirm`.

    Returns:
        The model with it, not refitted (None where none passed), and the trials, all others rejected.
    """
    passed = [t for t in trials if t.rejection is None]
    if not passed:
        return None, list(trials)
    best, close = best_and_close(passed)
    equivalent = [t for t in close if t is not best and indistinguishable(state, best, t)]

    def decided(t: Trial) -> Trial:
        if t is best or t.rejection:
            return t
        if t in equivalent:
            text = f"as good as {best.candidate.label}: these data cannot tell them apart"
            return t.rejected(RejectionReason.EQUIVALENT, text)
        text = f"{best.candidate.label} leaves less ({best.held_out:.3g} against {t.held_out:.3g})"
        return t.rejected(RejectionReason.WORSE, text)

    others = (t for t in trials if t is not best and t.losses is not None)
    rivals = sorted(others, key=lambda t: t.held_out)[:3]
    new = AcceptedEffect(best.round, best.candidate, best.x[-1], tuple(equivalent), tuple(rivals), gain=best.gain)
    log.info("found %s = %s; held-out error %.3g", best.candidate.label, best.x[-1].round(4), best.held_out)
    before = state.with_estimates(best.x[:-1])
    return replace(before, accepted=(*before.accepted, new)), [decided(t) for t in trials]


def best_and_close(passed: Sequence[Trial]) -> tuple[Trial, list[Trial]]:
    """The best, and those whose held-out error is close to it."""
    top = min(passed, key=lambda t: t.held_out + handicap(t))
    if top.held_out > FAR_LOSS:  # more is missing than this one: what bends to many shapes soaks it up
        top = min(passed, key=lambda t: t.held_out + handicap(t) + PARSIMONY * (t.candidate.size - 1) * top.gain)
    near = min(0.1 * max(top.gain, 0.0), 0.03 + 0.03 * top.held_out)
    close = [t for t in passed if t.held_out - top.held_out <= near]
    best = min(close, key=lambda t: (t.candidate.size, t.candidate.target in ("*", ACTUATED), t.held_out + handicap(t)))
    return best, close


def handicap(t: Trial) -> float:
    """Rare causes are blamed last: what they do imitates much, so they must be clearly better."""
    return rarity(t.candidate) * max(t.gain, 0.0)


def indistinguishable(state: SearchState, best: Trial, other: Trial) -> bool:
    """Whether the held-out losses of two candidates are so close that the data do not tell them apart."""
    assert best.losses is not None and other.losses is not None, "only refined candidates are compared"
    return no_clear_difference(best.losses, other.losses, state.windows.held_out.windows.episode)


def no_clear_difference(best: np.ndarray, other: np.ndarray, episodes: np.ndarray) -> bool:
    """The same of their losses, (n,), in windows of these episodes, (n,)."""
    _, error = paired_gain(other, best, episodes)
    return abs(float(other.mean() - best.mean())) <= max(2.0 * error, 0.005 * float(best.mean()))

"""Confirm and accept: refit what the screen proposes, judge it on held-out episodes, take the best."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.candidate_fit import effects_of
from idapt_pl.diagnosis.context import SearchContext
from idapt_pl.diagnosis.search_state import AcceptedEffect, SearchState, slopes_of_accepted
from idapt_pl.diagnosis.trial import Rejection, RejectionReason, Trial
from idapt_pl.effects.base import ACTUATED
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.plausible import plausible_range, rarity
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.wording import format_number
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)
STEPS, FIRST_STEPS = 5, 2
"""Of a fit with a candidate, and of these before those far behind are left."""
IN_THE_RACE = 0.7
"""Share of the way from the best candidate's loss to that without any, beyond which one is far behind."""
FAR_LOSS = 10.0
"""Held-out loss above which the best single effect is surely not all that is missing."""
NOTICEABLE_CHANGE = 0.03
"""Of the size that a candidate's scale calls noticeable: a further effect that is smaller is no finding, however sure.

What a found effect's law or the integration gets wrong by a per cent looks like that, unless it is much.
"""
LEFT_OVER = 1.6
"""Mean held-out loss (1 is noise) from which much is left: a change or a law is looked for, and small effects count."""
FURTHER_SHARE, SHARE_OF_A_PARAMETER = 0.05, 0.02
"""Share of the held-out error that a further effect must remove, and that each of its parameters must."""
SLIPS = 1e-3
"""Share of the error that was removed so far, which found effects may leave: their law is 3 % wrong, squared."""
CLEAR_GAIN = 0.25
"""Share of the held-out error that a first effect must remove where velocities are only slopes of positions.

What the slopes get wrong at the start of a window is not all in the noise; a lag of 2 ms or a little rotor inertia
takes 15 % of it away where nothing is missing (``benchmarks/diagnosis.py --positions``)."""
PARSIMONY = 0.15
"""Share of the best gain that every further parameter must then be worth."""


def confirm(context: SearchContext, state: SearchState, chosen: Sequence[Trial]) -> list[Trial]:
    """Refit candidates, the best of them without shortcuts, and see what these are worth on held-out episodes.

    Returns:
        Their trials, by what they leave on few windows, the least first; most of them rejected.
    """
    rough = rough_fits(context, state, chosen)
    slopes = slopes_of_accepted(context, state, state.windows.screen)
    without = float(context.loss(state.windows.scout, state.effects).mean())
    now = context.loss(state.windows.held_out, state.effects)
    first = (
        float(context.loss(state.windows.held_out, context.declared).mean()) if state.accepted else float(now.mean())
    )
    confirmed, refined = [], 0
    for t in rough:
        best = rough[0].rough_loss
        if refined < context.settings.refined and t.rough_loss <= best + 0.4 * max(without - best, 0.0):
            confirmed.append(refine(context, state, t, slopes, now, first))
            refined += 1
        else:
            text = f"refitted, it leaves {t.rough_loss:.3g}; {rough[0].candidate.label} leaves {best:.3g}"
            confirmed.append(t.rejected(RejectionReason.POOR_FIT, text))
    return confirmed


def rough_fits(context: SearchContext, state: SearchState, chosen: Sequence[Trial]) -> list[Trial]:
    """Refit candidates, with all accepted effects free, on few windows, best first.

    After some steps those that are far behind are left as they are.
    """
    slopes = slopes_of_accepted(context, state, state.windows.scout)
    without = float(context.loss(state.windows.scout, state.effects).mean())
    begun = []
    for t in chosen:
        start = replace(t, x=(*state.estimates, t.x[-1]))
        begun.append(rough_fit(context, state, start, FIRST_STEPS, slopes))
    best = min((t.rough_loss for t, _ in begun), default=without)
    near = best + IN_THE_RACE * max(without - best, 0.0)
    done = [rough_fit(context, state, t, STEPS - FIRST_STEPS, J)[0] if t.rough_loss <= near else t for t, J in begun]
    return sorted(done, key=lambda t: t.rough_loss)


def rough_fit(
    context: SearchContext, state: SearchState, t: Trial, steps: int, slopes: np.ndarray
) -> tuple[Trial, np.ndarray]:
    """Some steps from where a trial is; ``slopes`` by the first parameters. With the slopes by all where it ended."""
    candidates = [*state.candidates, t.candidate]
    fit = context.fit(state.windows.scout, state.fixed, candidates, t.x, steps, slopes=slopes)
    return replace(t, x=fit.x, rough_loss=fit.solution.loss), fit.solution.J


def refine(
    context: SearchContext, state: SearchState, t: Trial, slopes: np.ndarray, now: np.ndarray, first: float
) -> Trial:
    """Refit a candidate, with all accepted effects free, and judge it.

    Arguments as of :func:`objection`; ``slopes`` by what was accepted, (n rows, p).
    """
    candidates = [*state.candidates, t.candidate]
    x = context.fit(state.windows.screen, state.fixed, candidates, t.x, STEPS, slopes=slopes).x
    losses = context.loss(state.windows.held_out, (*state.fixed, *effects_of(candidates, x)))
    gain, error = paired_gain(now, losses, state.windows.held_out.windows.episode)
    t = replace(t, x=x, losses=losses, gain=gain, gain_error=error)
    return replace(t, rejection=objection(context, t, now, first, bool(state.accepted)))


def objection(context: SearchContext, t: Trial, now: np.ndarray, first: float, further: bool) -> Rejection | None:
    """Why a refitted candidate is not accepted, if it is not.

    Args:
        context: of the search.
        t: what became of the candidate.
        now: held-out losses without it, (n,).
        first: mean held-out loss of the model as it was given.
        further: whether it comes on top of effects that were found.
    """
    because, level = RejectionReason, float(now.mean())
    if text := beyond_its_kind(t.candidate, t.x[-1]):
        return Rejection(because.BEYOND_SENSORS, text)
    if t.gain - context.settings.sureness * t.gain_error <= 0:
        text = f"held-out gain {t.gain:.3g} ± {t.gain_error:.2g} is not surely positive"
        return Rejection(because.UNSURE_GAIN, text)
    if text := too_small_a_gain(context, t, level, further):
        return Rejection(because.SMALL_GAIN, text)
    if further and level < 1.05:
        return Rejection(because.NOISE_FLOOR, "the noise floor is reached without it")
    asked = max(FURTHER_SHARE, SHARE_OF_A_PARAMETER * t.candidate.size)
    if further and t.gain < max(asked * level, 0.08):
        removed = f"{100 * t.gain / level:.1f} %"
        text = f"as a further effect it removes {removed} of the held-out error, less than {100 * asked:g} %"
        return Rejection(because.SMALL_GAIN, text)
    if further and t.gain < SLIPS * (first - level):
        text = (
            "as a further effect it removes no more than what the effects found before may get wrong by a few per cent"
        )
        return Rejection(because.SMALL_GAIN, text)
    if further and too_small_a_change(t.candidate, t.x[-1], t.gain, level):
        change = f"{100 * t.candidate.change(t.x[-1]):.1g} %"
        return Rejection(because.SMALL_CHANGE, f"as a further effect it is too small to matter: {change} of its scale")
    if np.median(now) < 1.15 and t.gain < 0.15 * level:
        return Rejection(because.NOISE_FLOOR, "the typical window is at the noise floor already")
    if text := why_implausible(t.candidate, t.x[-1]):
        return Rejection(because.IMPLAUSIBLE, text)
    return None


def too_small_a_change(c: Candidate, x: np.ndarray, gain: float, level: float) -> bool:
    """Whether a further effect is too small to be a finding, and not because much was left that it explains.

    Args:
        c: the effect.
        x: its parameters, (p,).
        gain: of the mean held-out loss with it.
        level: that loss without it.
    """
    explains = level > LEFT_OVER and gain > CLEAR_GAIN * (level - 1.0)
    return c.change(x) < NOTICEABLE_CHANGE and not explains


def too_small_a_gain(context: SearchContext, t: Trial, level: float, further: bool) -> str:
    """Why a sure gain is too small, or nothing; ``level``: mean held-out loss without it. Else as of `objection`."""
    s = context.settings
    if t.gain < s.relative_gain * level:
        return f"it removes {100 * t.gain / level:.1f} % of the held-out error, less than {100 * s.relative_gain:g} %"
    if not context.sim.velocities and not further and t.gain < CLEAR_GAIN * level:
        removed = f"{100 * t.gain / level:.0f} %"
        return f"it removes {removed} of the error; without velocities {100 * CLEAR_GAIN:.0f} % are asked"
    if t.gain < s.removable_gain * max(level - 1.0, 0.0):
        above = 100 * t.gain / (level - 1)
        return f"it removes {above:.1f} % of what is above the floor, less than {100 * s.removable_gain:g} %"
    return ""


def beyond_its_kind(c: Candidate, x: np.ndarray) -> str:
    """Whether an error of a sensor would have to be larger than sensors have: then it stands in for something else."""
    if c.span is None or not issubclass(c.kind, SensingEffect) or not np.isclose(c.span, x[:, None]).any():
        return ""
    return f"its estimate ran to the end of what sensors are off by ({format_number(x[0])} {c.units()[0]})"


def why_implausible(c: Candidate, x: np.ndarray) -> str:
    """What about a candidate's parameters no machine has, in words; nothing where they are plausible.

    A fit that ran to the end of what is plausible would have gone further.
    """
    if c.plausible is None:
        return ""
    reasons = []
    for k, (low, high) in enumerate(c.plausible):
        entry, (least, most) = plausible_range(c.kind.name, c.names[k], c.nominal[k]), (b[k] for b in c.possible())
        above, below = x[k] >= high - close_to(high, high - low), x[k] <= low + close_to(low, high - low)
        above, below = above and high < most, below and low > least
        if entry is not None and (above or below) and high > low:
            end = f"{format_number(high if above else low)} {c.units()[k]}".removesuffix(" 1")
            reasons.append(f"{c.names[k]} {'above' if above else 'below'} {end} is not plausible: {entry.reason}")
    return "; ".join(reasons)


def close_to(end: float, width: float) -> float:
    """How far from the end of a range a fit counts as having run there: little of the range, and of the end itself.

    Ranges of factors are wide on one side: a thousandth of 0.01 to 100 is ten times its lower end.
    """
    return min(1e-3 * width, 0.02 * abs(end) or np.inf)


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
    new = AcceptedEffect(best.round, best.candidate, best.x[-1], tuple(equivalent), tuple(rivals))
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

"""Confirm and accept: refit what the screen proposes, judge it on held-out episodes, take the best."""

from __future__ import annotations

import logging

import numpy as np

from idapt_pl.diagnosis.search_state import AcceptedEffect, Search, Trial
from idapt_pl.effects.base import ACTUATED
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.wording import format_number
from idapt_pl.effects.world import ExternalForce
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import effects_of, robust_loss

log = logging.getLogger(__name__)
FAR_LOSS = 10.0
"""Held-out loss above which the best single effect is surely not all that is missing."""
NOTICEABLE_CHANGE = 0.03
"""Of the size that a candidate's scale calls noticeable: a further effect that is smaller is no finding, however sure.

What a found effect's law or the integration gets wrong by a per cent looks like that.
"""
CLEAR_SHARE = 0.25
"""Share of the held-out error that a first effect must remove where velocities are only slopes of positions.

What the slopes get wrong at the start of a window is not all in the noise; a lag of 2 ms or a little rotor inertia
takes 15 % of it away where nothing is missing (``benchmarks/diagnosis.py --positions``)."""
PARSIMONY = 0.15
"""Share of the best gain that every further parameter must then be worth."""


def confirm(search: Search, chosen: list[Trial]) -> list[Trial]:
    """Refit candidates, the best of them without shortcuts, and see what these are worth on held-out episodes."""
    losses = {id(t): rough_fit(search, t) for t in chosen}
    chosen = sorted(chosen, key=lambda t: losses[id(t)])
    now_fit = float(robust_loss(search.z(search.scout, search.effects)).mean())
    now = search.loss(search.effects)
    confirmed = []
    for t in chosen:
        best = losses[id(chosen[0])]
        if len(confirmed) < search.settings.refined and losses[id(t)] <= best + 0.4 * max(now_fit - best, 0.0):
            refine(search, t, now)
            confirmed.append(t)
        else:
            t.rejected_because = (
                f"refitted, it leaves {losses[id(t)]:.3g}; {chosen[0].candidate.label} leaves {best:.3g}"
            )
    return confirmed


def rough_fit(search: Search, t: Trial) -> float:
    """Refit a candidate on few windows. Returns the loss."""
    fit = search.refit(search.scout, [*search.accepted, t.candidate], [*search.x, t.x[-1]], 3)
    t.x = fit.x
    return fit.loss


def refine(search: Search, t: Trial, now: np.ndarray) -> None:
    """Refit a candidate, with all accepted effects free, and judge it; ``now``: held-out losses without it."""
    candidates = [*search.accepted, t.candidate]
    t.x = search.refit(search.screen, candidates, t.x, 3).x
    t.losses = search.loss((*search.fixed, *effects_of(candidates, t.x)))
    t.gain, t.gain_error = paired_gain(now, t.losses, search.held_out.windows.episode)
    t.rejected_because = objection(search, t, now)


def objection(search: Search, t: Trial, now: np.ndarray) -> str:
    """Why a refitted candidate is not accepted, or nothing."""
    s, level = search.settings, float(now.mean())
    if beyond_its_kind(t.candidate, t.x[-1]):
        return f"its estimate ran to the end of what sensors are off by ({format_number(t.x[-1][0])} {t.candidate.units()[0]})"
    if t.gain - s.sureness * t.gain_error <= 0:
        return f"held-out gain {t.gain:.3g} ± {t.gain_error:.2g} is not surely positive"
    if t.gain < s.relative_gain * level:
        return f"it removes {100 * t.gain / level:.1f} % of the held-out error, less than {100 * s.relative_gain:g} %"
    if not search.sim.velocities and not t.round and t.gain < CLEAR_SHARE * level:
        return f"it removes {100 * t.gain / level:.0f} % of the error; without velocities {100 * CLEAR_SHARE:.0f} % are asked"
    if t.gain < s.removable_gain * max(level - 1.0, 0.0):
        above = 100 * t.gain / (level - 1)
        return f"it removes {above:.1f} % of what is above the floor, less than {100 * s.removable_gain:g} %"
    if t.round and level < 1.05:
        return "the noise floor is reached without it"
    if t.round and t.gain < max(0.05 * level, 0.08):
        return f"as a further effect it removes {100 * t.gain / level:.1f} % of the held-out error, less than 5 %"
    if t.round and t.candidate.change(t.x[-1]) < NOTICEABLE_CHANGE:
        return f"as a further effect it is too small to matter: {100 * t.candidate.change(t.x[-1]):.1g} % of its scale"
    if np.median(now) < 1.15 and t.gain < 0.15 * level:
        return "the typical window is at the noise floor already"
    return ""


def beyond_its_kind(c: Candidate, x: np.ndarray) -> bool:
    """Whether an error of a sensor would have to be larger than sensors have: then it stands in for something else."""
    return c.span is not None and issubclass(c.kind, SensingEffect) and bool(np.isclose(c.span, x[:, None]).any())


def accept(search: Search, confirmed: list[Trial]) -> AcceptedEffect | None:
    """The best of those that passed: fewest parameters among those that are as good as the best."""
    passed = [t for t in confirmed if not t.rejected_because]
    if not passed:
        return None
    top = min(passed, key=lambda t: t.held_out + handicap(t))
    if top.held_out > FAR_LOSS:  # more is missing than this one: what bends to many shapes soaks it up
        top = min(passed, key=lambda t: t.held_out + handicap(t) + PARSIMONY * (t.candidate.size - 1) * top.gain)
    near = min(0.1 * max(top.gain, 0.0), 0.03 + 0.03 * top.held_out)
    close = [t for t in passed if t.held_out - top.held_out <= near]
    best = min(close, key=lambda t: (t.candidate.size, t.candidate.target in ("*", ACTUATED), t.held_out + handicap(t)))
    for t in passed:
        if t is not best:
            t.rejected_because = f"{best.candidate.label} leaves less ({best.held_out:.3g} against {t.held_out:.3g})"
    alike = [
        t for t in close if t is not best and abs(t.held_out - best.held_out) <= indistinguishable(search, best, t)
    ]
    for t in alike:
        t.rejected_because = f"as good as {best.candidate.label}: these data cannot tell them apart"
    rivals = sorted((t for t in confirmed if t is not best), key=lambda t: t.held_out)[:3]
    search.x = best.x[:-1]
    search.found.append(AcceptedEffect(best.candidate, best.x[-1], equivalent=alike, rivals=rivals))
    log.info("found %s = %s; held-out error %.3g", best.candidate.label, best.x[-1].round(4), best.held_out)
    return search.found[-1]


def handicap(t: Trial) -> float:
    """Sensors and unseen hands are blamed last: what they do imitates much, so they must be clearly better."""
    return 0.05 * max(t.gain, 0.0) if issubclass(t.candidate.kind, SensingEffect | ExternalForce) else 0.0


def indistinguishable(search: Search, a: Trial, b: Trial) -> float:
    """How far apart two held-out losses may be for the data not to tell the two candidates apart."""
    _, error = paired_gain(b.losses, a.losses, search.held_out.windows.episode)
    return max(2.0 * error, 0.005 * a.held_out)

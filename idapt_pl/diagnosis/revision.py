"""Reopen early choices: swap an effect for a rival of its round, leave out what has become needless."""

from __future__ import annotations

import logging

from idapt_pl.diagnosis.acceptance import FAR_LOSS, NOTICEABLE_CHANGE, PARSIMONY, beyond_its_kind, handicap, rough_fit
from idapt_pl.diagnosis.numerics import retest_numerics
from idapt_pl.diagnosis.screening import screen_candidates, shortlist
from idapt_pl.diagnosis.search_state import AcceptedEffect, Search, Trial
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import effects_of

log = logging.getLogger(__name__)


SWAP_PASSES = 2
"""How often all found effects are gone through, while much is unexplained and rivals go on taking places."""


def swap_for_rivals(search: Search) -> None:
    """Was an early choice wrong, made before later effects and the numerics were known? Try its rivals again.

    Where several effects are missing at once and much of the error stays, the first choice was made in their shadow,
    and so were its rivals: then every effect has to stand against whatever the screen finds best in its place.
    """
    search.progress("trying rivals", 0.88)
    for _ in range(SWAP_PASSES):
        far = len(search.found) > 1 and float(search.loss(search.effects).mean()) > FAR_LOSS
        turns = search.found if far or len(search.found) < 2 else search.found[:-1]
        swapped = [swap_one(search, f, rivals_for_place(search, f) if far else f.rivals) for f in list(turns)]
        if not far or not any(swapped):
            return


def rivals_for_place(search: Search, f: AcceptedEffect) -> list[Trial]:
    """The best candidates for the place of a found effect, given the others; roughly refitted."""
    found, x = search.found, search.x
    search.found = [g for g in found if g is not f]
    search.settle()
    chosen = shortlist(screen_candidates(search, len(found)), search.settings.confirm)
    losses = {id(t): rough_fit(search, t) for t in chosen}
    search.found, search.x = found, x
    rivals = [t for t in chosen if (t.candidate.label, t.candidate.names) != (f.candidate.label, f.candidate.names)]
    return sorted(rivals, key=lambda t: losses[id(t)])[:3]


def swap_one(search: Search, f: AcceptedEffect, rivals: list[Trial]) -> bool:
    """Whether a rival took the place of an effect."""
    rest = [g for g in search.found if g is not f]
    now = search.loss(search.effects)
    best, best_loss, best_x = None, float(now.mean()), []
    for t in rivals:
        candidates = [*(g.candidate for g in rest), t.candidate]
        fit = search.refit(search.fit, candidates, [*(g.x for g in rest), t.x[-1]], 4)
        after = search.loss((*search.fixed, *effects_of(candidates, fit.x)))
        gain, error = paired_gain(now, after, search.held_out.windows.episode)
        dearer = PARSIMONY * max(t.candidate.size - f.candidate.size, 0) * max(gain, 0.0)
        if beyond_its_kind(t.candidate, fit.x[-1]):
            continue
        if after.mean() + handicap(t) + dearer < best_loss and gain > max(error, 0.03 * float(now.mean())):
            best, best_loss, best_x = t, float(after.mean()), fit.x
    if best is None:
        return False
    log.info("%s in place of %s: %.3g", best.candidate.label, f.candidate.label, best_loss)
    f.candidate, f.x, f.equivalent = best.candidate, best_x[-1], []
    for g, x in zip(rest, best_x[:-1], strict=True):
        g.x = x
    search.renew()
    search.settle()
    retest_numerics(search)
    return True


def eliminate_needless(search: Search) -> None:
    """Leave out again what the later effects have made needless."""
    search.progress("pruning", 0.9)
    s = search.settings
    for f in list(search.found):
        if len(search.found) < 2:
            return
        rest = [g for g in search.found if g is not f]
        candidates = [g.candidate for g in rest]
        fit = search.refit(search.fit, candidates, [g.x for g in rest], 4)
        with_it, without = search.loss(search.effects), search.loss((*search.fixed, *effects_of(candidates, fit.x)))
        gain, error = paired_gain(without, with_it, search.held_out.windows.episode)
        needless = gain < max(s.relative_gain * float(without.mean()), s.sureness * error)
        slight = f is not search.found[0] and f.candidate.change(f.x) < NOTICEABLE_CHANGE
        if needless or slight:
            log.info("pruned %s: without it %.3g, with it %.3g", f.candidate.label, without.mean(), with_it.mean())
            search.found = rest
            search.x = fit.x

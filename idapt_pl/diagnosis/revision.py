"""Reopen early choices: swap an effect for a rival of its round, leave out what has become needless."""

from __future__ import annotations

import logging

from idapt_pl.diagnosis.confirming import handicap
from idapt_pl.diagnosis.integration import retest_numerics
from idapt_pl.diagnosis.state import Found, Search
from idapt_pl.diagnosis.statistics import effects_of, paired_gain

log = logging.getLogger(__name__)


def swap(search: Search) -> None:
    """Was an early choice wrong, made before later effects and the numerics were known? Try its rivals again."""
    search.progress("trying rivals", 0.88)
    for f in search.found[:-1] if len(search.found) > 1 else search.found:
        if swap_one(search, f):
            search.renew()
            search.settle()
            retest_numerics(search)


def swap_one(search: Search, f: Found) -> bool:
    """Whether a rival took the place of an effect."""
    rest = [g for g in search.found if g is not f]
    now = search.loss(search.effects)
    best, best_loss, best_x = None, float(now.mean()), []
    for t in f.rivals:
        candidates = [*(g.candidate for g in rest), t.candidate]
        fit = search.refit(search.fit, candidates, [*(g.x for g in rest), t.x[-1]], 4)
        after = search.loss((*search.fixed, *effects_of(candidates, fit.x)))
        gain, error = paired_gain(now, after, search.held_out.windows.episode)
        if after.mean() + handicap(t) < best_loss and gain > max(error, 0.03 * float(now.mean())):
            best, best_loss, best_x = t, float(after.mean()), fit.x
    if best is None:
        return False
    log.info("%s in place of %s: %.3g", best.candidate.label, f.candidate.label, best_loss)
    f.candidate, f.x, f.equivalent = best.candidate, best_x[-1], []
    for g, x in zip(rest, best_x[:-1], strict=True):
        g.x = x
    return True


def prune(search: Search) -> None:
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
        if gain < max(s.relative_gain * float(without.mean()), s.sureness * error):
            log.info("pruned %s: without it %.3g, with it %.3g", f.candidate.label, without.mean(), with_it.mean())
            search.found = rest
            search.x = fit.x

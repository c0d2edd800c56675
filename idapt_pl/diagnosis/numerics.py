"""Is it how the equations are integrated? Time step and integrator as discrete effects."""

from __future__ import annotations

import logging

from idapt_pl.diagnosis.candidates import numerics_candidates
from idapt_pl.diagnosis.search_state import Search
from idapt_pl.estimation.intervals import paired_gain
from idapt_pl.estimation.least_squares import effects_of, robust_loss

log = logging.getLogger(__name__)
NUMERICS_FLOOR = 1.05
"""Loss at which nothing is left for other numerics to gain."""


def retest_numerics(search: Search) -> None:
    """Try other numerics, with the accepted effects refitted; again after every addition."""
    search.progress("numerics", 0.08)
    if not search.settings.numerics or any(e.name == "numerics" for e in search.declared):
        return
    others = tuple(e for e in search.fixed if e.name != "numerics")
    level = float(robust_loss(search.z(search.screen, search.effects)).mean())
    if level < NUMERICS_FLOOR:
        return
    best, best_loss, best_x = None, level, []
    for effect in numerics_candidates(search.sim.model):
        if effect in search.fixed:
            continue
        x = search.x
        if search.found:  # estimates shift with the integrator: compare after a refit
            x = search.refit(search.screen, search.accepted, x, 3, fixed=(*others, effect)).x
        tried = (*others, effect, *effects_of(search.accepted, x))
        loss = float(robust_loss(search.z(search.screen, tried)).mean())
        if loss < 0.98 * level and loss < 1.3 * best_loss:  # about as good: the finer one, tried later
            best, best_x, best_loss = effect, x, min(loss, best_loss)
    if best is None:
        return
    now = search.loss(search.effects)
    after = search.loss((*others, best, *effects_of(search.accepted, best_x)))
    gain, error = paired_gain(now, after, search.held_out.windows.episode)
    level = float(now.mean())
    if gain - search.settings.sureness * error > 0 and gain > max(0.03 * level, 0.1 * max(level - 1.0, 0.0), 0.05):
        log.info("numerics: %s leaves %.3g of %.3g", best.to_dict()["parameters"], after.mean(), level)
        search.fixed, search.x = (*others, best), best_x
        search.renew()
        search.settle()

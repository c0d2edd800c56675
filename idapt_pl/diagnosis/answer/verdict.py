"""The verdict: from errors on held-out episodes to one of four words."""

from __future__ import annotations

import numpy as np

from idapt_pl.diagnosis.answer.result import Verdict
from idapt_pl.diagnosis.rounds.replay import at_rest, motion
from idapt_pl.diagnosis.rounds.screening import ScoreTest
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.prediction.data import over_impacts

FLOOR, SLOPED_FLOOR = 1.6, 4.0
"""Loss up to which a model may be right; the other one where velocities are slopes of positions, which err more."""

STILL = 5.0
"""A channel that moves less within a window than so many standard deviations of its noise shows nothing."""

UNPREDICTABLE = 4.0, 6.0
"""Loss of the typical window, and of one in four, from which even a remainder that nothing predicts is no noise."""


def decide(
    context: SearchContext, state: SearchState, before: float, after: float, losses: np.ndarray, predictable: float
) -> Verdict:
    """The verdict; a remainder counts if it is typical of the windows, of a quarter, of impacts, or could be predicted.

    Args:
        context: of the search.
        state: where it ended.
        before: held-out error of the model as it was given, in standard deviations.
        after: with what was found.
        losses: the same of each held-out window, squared, (n,).
        predictable: share of the squared error left that a black box predicts.
    """
    median, upper = np.quantile(losses, [0.5, 0.75])
    floor = FLOOR if context.sim.velocities else SLOPED_FLOOR
    hit = over_impacts(context.sim.data, state.windows.held_out.windows)
    if hit.any():  # impacts are few and short, and all that tells about them
        upper = max(upper, float(np.median(losses[hit])))
    left_over = after**2 > floor and (median > 1.5 or upper > UNPREDICTABLE[1] or predictable > 0.25)
    if state.accepted:
        poor = removed_share(before, after) < 0.75 or predictable > 0.3 or median > 2.0 or upper > UNPREDICTABLE[1]
        return Verdict.UNEXPLAINED_RESIDUAL if left_over and poor else Verdict.EFFECTS_FOUND
    if left_over and (predictable > 0.1 or median > UNPREDICTABLE[0] or upper > UNPREDICTABLE[1]):
        return Verdict.UNEXPLAINED_RESIDUAL
    return Verdict.INSUFFICIENT_EXCITATION if too_quiet(context, state) else Verdict.NO_MISSING_EFFECT


def removed_share(before: float, after: float) -> float:
    """Share of the removable squared error that was removed; 0 where there was none."""
    return float(np.clip((before**2 - after**2) / max(before**2 - 1.0, 1e-9), -1.0, 1.0)) if before > 1.02 else 0.0


def too_quiet(context: SearchContext, state: SearchState) -> bool:
    """Whether not even a change by half of what an actuator (or a body's mass) does would have been seen.

    Free bodies move alike whatever their mass: where none is driven, whether they move at all.
    """
    if at_rest(context, state):
        return True
    if not context.sim.model.nu:
        windows, noise = state.windows.screen.windows, state.windows.noise.sensors
        moved = np.sqrt(np.square(motion(context, windows)).mean((0, 1)))
        return bool((moved < STILL * noise)[context.sim.compared].all())
    wanted = [c for c in context.candidates if c.kind.name == "actuator_gain" and c.target != "*"]
    wanted = wanted or [c for c in context.candidates if c.kind.name == "body_mass"]
    if not wanted:
        return False
    screen, limits = ScoreTest(context, state, state.windows.screen), []
    for c in wanted:
        D = screen.derivative(c, np.array(c.nominal))
        limits.append(context.settings.z * c.scale[0] / max(float(np.linalg.norm(D)), 1e-12) / c.nominal[0])
    return float(np.median(limits)) > 0.5

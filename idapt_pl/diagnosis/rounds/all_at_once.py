"""What every machine has, of all joints and motors at once, where a search one by one stays far from the recordings.

Friction alone may make forecasts worse where rotor inertia is missing as well, and a motor's gain where both are. What
an engineer fits together is tried together then, one value for all joints, and what is needless goes.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.effects.actuators import ActuatorGain, ActuatorKp, MotorResistance
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
USUAL_TOGETHER: tuple[tuple[type[Effect], ...], ...] = (
    (JointDamping,), (JointFrictionloss,), (JointArmature,), (ActuatorKp, MotorResistance, ActuatorGain),
)  # fmt: skip
"""Effects that are tried together; of those in a row the first that the model has."""

WORTH_IT = 0.8
"""Share of the held-out loss that they may leave."""

BEGIN = 10.0
"""Scales from which what a model has nothing of is fitted: dry friction that starts at nothing may stay there, where it
helps only beside rotor inertia."""


def add_all_at_once(context: SearchContext, state: SearchState, round: int) -> SearchState:
    """The state with the usual effects of all joints and motors; the same where they do not take away much.

    Args:
        context: of the search.
        state: the current model.
        round: number of the first of them, beyond those of what was accepted.
    """
    if judges_forces(state.windows.fit):
        return state
    context.progress("damping, friction, rotor inertia and motors of all joints", 0.4)
    new = [AcceptedEffect(round + k, c, beginning(c)) for k, c in enumerate(usual(context, state))]
    wider = refit_accepted(context, replace(state, accepted=(*state.accepted, *new)), iterations=10)
    if not new or level(context, wider) > WORTH_IT * level(context, state):
        return state
    other = eliminate_needless(context, wider)
    if len(other.accepted) > context.settings.max_effects:
        return state
    log.info("all at once: %s", ", ".join(c.label for c in other.candidates))
    return refit_accepted(context, renew(context, other))


def usual(context: SearchContext, state: SearchState) -> Iterator[Candidate]:
    """Candidates that are tried together, one value for all joints or motors, but for those that are accepted."""
    known = {c.label for c in state.candidates}
    for kinds in USUAL_TOGETHER:
        kind = next((k for k in kinds if any(c.kind is k for c in context.candidates)), None)
        every = [c for c in context.candidates if c.kind is kind and c.label not in known]
        shared = next((c for target in ("*", ACTUATED) for c in every if c.target == target), None)
        if shared is not None or len(every) == 1:
            yield shared or every[0]


def beginning(c: Candidate) -> np.ndarray:
    """Parameters from which a candidate is fitted, (p,)."""
    nominal, (low, high) = np.array(c.nominal, float), c.bounds()
    return np.clip(np.where(nominal == 0, BEGIN * np.array(c.scale), nominal), low, high)

"""One value for all joints, motors or bodies, taken apart into one for each."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.effects.base import ACTUATED
from idapt_pl.effects.candidate import Candidate, actuated_dofs, scalar_joints

log = logging.getLogger(__name__)
AS_GOOD = 1.02
"""Of the loss before, what fewer effects may leave."""


def taken_apart(context: SearchContext, c: Candidate) -> list[Candidate]:
    """The same effect on each that a shared one acts on; nothing where it is not shared."""
    if c.target not in ("*", ACTUATED):
        return []
    model = context.sim.model
    driven = {name for _, v, name in scalar_joints(model) if v in actuated_dofs(model)}
    parts = [x for x in context.candidates if same_effect(x, c)]
    return [x for x in parts if x.target not in ("*", ACTUATED) and (c.target == "*" or x.target in driven)]


def same_effect(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates differ in their targets at most."""
    return one.kind is other.kind and one.names == other.names


def single_for_shared(context: SearchContext, state: SearchState) -> SearchState:
    """The state with effects of their own in the place of a shared one, where these are fewer and as good.

    A stronger motor on one of two joints may be found as stronger motors on both and a weaker one on the other.
    """
    for shared in state.accepted:
        alike = [a for a in state.accepted if same_effect(a.candidate, shared.candidate)]
        besides = [a for a in alike if a is not shared]
        parts = taken_apart(context, shared.candidate) if besides else []
        if not parts:
            continue
        known, first = {a.candidate.label for a in besides}, 1 + max(a.round for a in state.accepted)
        own = [AcceptedEffect(first + k, c, shared.x.copy()) for k, c in enumerate(parts) if c.label not in known]
        kept = [replace(a, x=together(a, shared)) if a in besides else a for a in state.accepted if a is not shared]
        other = eliminate_needless(context, refit_accepted(context, replace(state, accepted=(*kept, *own))))
        fewer = len(other.accepted) < len(state.accepted)
        if fewer and level(context, other) <= AS_GOOD * level(context, state):
            log.info("%s taken apart: %s", shared.candidate.label, ", ".join(c.label for c in other.candidates))
            return refit_accepted(context, renew(context, other))
    return state


def together(own: AcceptedEffect, shared: AcceptedEffect) -> np.ndarray:
    """What an effect and a shared one come to: factors are multiplied, other values added."""
    nominal = np.array(own.candidate.nominal, float)
    return np.where(nominal == 1.0, own.x * shared.x, own.x + shared.x - nominal)

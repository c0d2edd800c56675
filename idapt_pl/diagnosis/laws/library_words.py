"""A law that is made of effects of the library: they are tried together, where none was let in alone."""

from __future__ import annotations

import logging
from dataclasses import replace

import mujoco
import numpy as np

from idapt_pl.diagnosis.laws.candidate import LawCandidate
from idapt_pl.diagnosis.rounds.gates import CLEAR_GAIN
from idapt_pl.diagnosis.rounds.revision import eliminate_needless
from idapt_pl.diagnosis.rounds.taking_apart import taken_apart
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.effects.candidate import Candidate
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)
SAME_IN_LIBRARY = {
    "A": "actuator_bias",
    "A*q": "joint_stiffness",
    "A*v": "joint_damping",
    "A*abs(v)*v": "joint_drag",
    "A*tanh(v/P)": "joint_frictionloss",
    "A*u": "actuator_gain",
    "A*motor": "actuator_gain",
}
"""Terms of a law, and the effects that they are."""
MANY_STEPS = 15


def explained_by_library(context: SearchContext, state: SearchState, law: LawCandidate) -> SearchState | None:
    """The state with the effects that a law is made of, if these explain a clear part of what is left.

    What is wrong with one joint can look like a little of something else on all: with a weak motor on one of two
    joints, the damping of the other came out as a damping of both, and the motor's gain was refused beside it. The law
    that is left then takes that damping back. So an effect of all joints is taken apart where the law has its kind.
    """
    kinds = {SAME_IN_LIBRARY[t.text] for t in law.terms}
    kept, added = [], list[tuple[Candidate, np.ndarray]]()
    for a in state.accepted:
        parts = taken_apart(context, a.candidate) if a.candidate.kind.name in kinds else []
        added += [(c, a.x.copy()) for c in parts]
        kept += [] if parts else [a]
    known = {a.candidate.label for a in kept} | {c.label for c, _ in added}
    places = {law.target, *motors_of(context.sim.model, law.target)}
    new = [c for c in context.candidates if c.kind.name in kinds and c.target in places and c.label not in known]
    added += [(c, np.array(c.nominal, float)) for c in new]
    if len(kept) + len(added) > context.settings.max_effects:
        return None
    first = 1 + max((a.round for a in kept), default=-1)
    accepted = (*kept, *(AcceptedEffect(first + k, c, x) for k, (c, x) in enumerate(added)))
    other = eliminate_needless(context, refit_accepted(context, replace(state, accepted=accepted), MANY_STEPS))
    now, after = (context.loss(state.windows.held_out, s.effects) for s in (state, other))
    gain, error = paired_gain(now, after, state.windows.held_out.windows.episode)
    if gain < max(context.settings.sureness * error, CLEAR_GAIN * float(now.mean())):
        return None
    log.info("%s in words of the library: %.3g, %.3g before", law.label, after.mean(), now.mean())
    return refit_accepted(context, renew(context, other))


def motors_of(model: mujoco.MjModel, joint: str) -> list[str]:
    """Actuators on a joint."""
    on_it = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (
        model.actuator_trnid[:, 0] == model.joint(joint).id
    )
    return [model.actuator(i).name for i in np.flatnonzero(on_it)]

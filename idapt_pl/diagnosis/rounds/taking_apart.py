"""One value for all joints, motors or bodies, taken apart into one for each; a gain, into all that it scales."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted, renew
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.base import ACTUATED, Effect, names_in
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import Candidate, actuated_dofs, scalar_joints
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss, JointStiffness
from idapt_pl.prediction.force_windows import judges_forces

log = logging.getLogger(__name__)
AS_GOOD = 1.02
"""Of the loss before, what fewer effects may leave."""
ROTORS = JointArmature, JointDamping, JointFrictionloss
"""What a motor has at its joint."""
SCALED: tuple[type[Effect], ...] = (BodyMass, JointDamping, JointFrictionloss, JointArmature, JointStiffness)
"""What a gain of all motors scales, the other way round."""
MOST_SCALED = 8
"""Of these that a model may have, to be fitted together."""


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


def own_for_shared_motor(context: SearchContext, state: SearchState) -> SearchState:
    """The state with a joint's own rotor, damping and friction in place of a motor shared with the joint before.

    Where these are as good: a motor that the joint before does not turn is the joint's own.
    """
    for motor in [a for a in state.accepted if a.candidate.kind is SharedMotor]:
        felt = dict(zip(motor.candidate.names, motor.x, strict=True))
        second = names_in(motor.candidate.target, [j.name for j in context.sim.spec.joints])[-1]
        known, first = {c.label for c in state.candidates}, 1 + max(a.round for a in state.accepted)
        own = [c for c in context.candidates if c.kind in ROTORS and c.target == second and c.label not in known]
        new = [AcceptedEffect(first + k, c, np.add(c.nominal, felt[c.names[0]])) for k, c in enumerate(own)]
        kept = tuple(a for a in state.accepted if a is not motor)
        other = eliminate_needless(context, refit_accepted(context, replace(state, accepted=(*kept, *new))))
        if level(context, other) <= AS_GOOD * level(context, state):
            log.info("%s is the second joint's own", motor.candidate.label)
            return refit_accepted(context, renew(context, other))
    return state


def together(own: AcceptedEffect, shared: AcceptedEffect) -> np.ndarray:
    """What an effect and a shared one come to: factors are multiplied, other values added."""
    nominal = np.array(own.candidate.nominal, float)
    return np.where(nominal == 1.0, own.x * shared.x, own.x + shared.x - nominal)


def many_for_one_gain(context: SearchContext, state: SearchState) -> SearchState:
    """The state without a gain of all motors, where changes of some of what it scales are fewer and as good.

    A heavier pole in a stiffer bearing moves as one of a weaker motor on a lighter cart does. It is undone by giving
    all masses, dampings, frictions, rotors and springs the inverse of the gain; most of them are then as in the model.
    """
    gains = [a for a in state.accepted if a.candidate.kind is ActuatorGain and a.candidate.names == ("gain",)]
    gain = next((a for a in gains if a.candidate.target == "*" or context.sim.model.nu == 1), None)
    if gain is None or len(state.accepted) < 2 or judges_forces(state.windows.fit):
        return state
    rest, first = [a for a in state.accepted if a is not gain], 1 + max(a.round for a in state.accepted)
    known = {a.candidate.label for a in rest}
    scaled = [
        c for c in context.candidates if c.kind in SCALED and c.target not in ("*", ACTUATED) and c.nominal[0] > 0
    ]
    own = [c for c in scaled if c.label not in known]
    if not own or len(scaled) > MOST_SCALED:
        return state
    inverse = 1 / max(float(gain.x[0]), 1e-3)
    kept = [replace(a, x=a.x * inverse) if a.candidate.kind in SCALED else a for a in rest]
    new = [AcceptedEffect(first + k, c, inverse * np.array(c.nominal, float)) for k, c in enumerate(own)]
    other = eliminate_needless(context, refit_accepted(context, replace(state, accepted=(*kept, *new))))
    fewer = sum(c.size for c in other.candidates) < sum(c.size for c in state.candidates)
    if not fewer or level(context, other) > AS_GOOD * level(context, state):
        return state
    log.info("%s undone: %s", gain.candidate.label, ", ".join(c.label for c in other.candidates))
    return refit_accepted(context, renew(context, other))

"""What every machine has at every joint, all at once: damping, dry friction and rotor inertia.

Where sensors are so good that a search one effect at a time ends nowhere
(:mod:`~idapt_pl.diagnosis.rounds.unexplained_forces`), it begins with these, as an engineer would, from what inverse
dynamics says of them; what is needless goes. Motors that two joints share are among them: where a joint's own friction
stands in for theirs, no search one effect at a time finds them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from idapt_pl.diagnosis.rounds.force_regression import Cause, ForceRegression
from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.rounds.unexplained_forces import judge_by_forces, unexplained_forces
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.force_windows import instants_of, lacking_forces, measured_motion

log = logging.getLogger(__name__)
AT_EVERY_JOINT: tuple[type[Effect], ...] = (JointDamping, JointFrictionloss, JointArmature)

SHARED_EXPLAINS = 0.3
"""Share of the force (squared) that the own causes of two joints leave, from which on they share a motor."""

ROOM = 0.3
"""Share of the force that usual causes leave that counts as unexplained at least: so much may still be found."""


OF_THE_LARGEST = 1e-4
"""Of the force unexplained elsewhere, that counts as unexplained at a joint that feels next to nothing."""


def begin_with_usual_causes(context: SearchContext, state: SearchState) -> SearchState:
    """A state without effects, judged by forces, with the usual effects of every joint that are not needless.

    Forces count in units of what a black box leaves of them, if that is less than what these effects leave, and no less
    than a share of it: else the one joint that the black box happens to know best would decide all.
    """
    context.progress("damping, friction and rotor inertia of all joints", 0.15)
    instants = instants_of(state.windows.sensitivity.fit)
    motion, lacking = measured_motion(context.sim, instants), lacking_forces(context.sim, state.effects, instants)
    found = causes_at_joints(context, ForceRegression(context.sim.model, motion, lacking))
    accepted = tuple(AcceptedEffect(k, c, x) for k, (c, x) in enumerate(found))
    with_all = replace(state, accepted=accepted)
    left = robust_deviation(lacking_forces(context.sim, with_all.effects, instants))
    size = np.maximum(np.minimum(unexplained_forces(context, state), left), ROOM * left)
    size = np.maximum(size, OF_THE_LARGEST * size.max() + 1e-12)
    with_all = refit_accepted(context, judge_by_forces(context, with_all, size))
    log.info("judged by forces, usual causes of all joints at once: held-out error %.3g", level(context, with_all))
    return eliminate_needless(context, with_all)


def causes_at_joints(context: SearchContext, forces: ForceRegression) -> list[Cause]:
    """The usual causes of all joints, and motors that two joints share where these explain much more."""
    found, shared = {v: forces.fit(own_causes(context, v)) for v in range(context.sim.model.nv)}, list[Cause]()
    for share, pair, together in sorted(shared_motors(context, forces, found), key=lambda x: x[0]):
        if share < 1 - SHARED_EXPLAINS and found.keys() >= set(pair):
            log.info("%s: %.2g of the force (squared) is left", together[-1][0].label, share)
            shared += together
            for v in pair:
                del found[v]
    return [*(cause for of_joint in found.values() for cause in of_joint), *shared]


def shared_motors(
    context: SearchContext, forces: ForceRegression, found: Mapping[int, list[Cause]]
) -> Iterator[tuple[float, list[int], list[Cause]]]:
    """For each motor that two joints may share: the share of the force (squared) that is left with it, the two degrees
    of freedom, and their own causes with it.

    ``found`` are the own causes of every degree of freedom.
    """
    for c in context.candidates:
        if c.kind is SharedMotor and "ratio" not in c.names:
            pair = forces.dofs(c.target)
            own = [cause for v in pair for cause in found[v]]
            size = robust_deviation(forces.left(own)) + 1e-12
            together = forces.fit([*(k for k, _ in own), c], size)
            before, after = (np.square(forces.left(x) / size)[:, pair].mean() for x in (own, together))
            yield float(after / (before + 1e-12)), pair, together


def own_causes(context: SearchContext, v: int) -> list[Candidate]:
    """Candidates for the usual causes at a degree of freedom alone."""
    model = context.sim.model
    single = [c for c in context.candidates if c.kind in AT_EVERY_JOINT and c.target not in ("*", ACTUATED)]
    return [c for c in single if model.joint(c.target).dofadr[0] == v]

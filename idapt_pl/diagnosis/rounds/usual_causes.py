"""What every machine has at every joint, all at once: damping, dry friction and rotor inertia.

Where sensors are so good that a search one effect at a time ends nowhere
(:mod:`~idapt_pl.diagnosis.rounds.unexplained_forces`), it begins with these, as an engineer would, from what inverse
dynamics says of them; what is needless goes.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.rounds.unexplained_forces import judge_by_forces, unexplained_forces
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.force_windows import MeasuredMotion, instants_of, lacking_forces, measured_motion

log = logging.getLogger(__name__)
AT_EVERY_JOINT: tuple[type[Effect], ...] = (JointDamping, JointFrictionloss, JointArmature)

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
    found = [a for v in range(context.sim.model.nv) for a in usual_causes(context, motion, lacking[:, v], v)]
    accepted = tuple(AcceptedEffect(k, c, x) for k, (c, x) in enumerate(found))
    with_all = replace(state, accepted=accepted)
    left = robust_deviation(lacking_forces(context.sim, with_all.effects, instants))
    size = np.maximum(np.minimum(unexplained_forces(context, state), left), ROOM * left)
    size = np.maximum(size, OF_THE_LARGEST * size.max() + 1e-12)
    with_all = refit_accepted(context, judge_by_forces(context, with_all, size))
    log.info("judged by forces, usual causes of all joints at once: held-out error %.3g", level(context, with_all))
    return eliminate_needless(context, with_all)


def usual_causes(
    context: SearchContext, motion: MeasuredMotion, lacking: np.ndarray, v: int
) -> list[tuple[Candidate, np.ndarray]]:
    """The usual causes at a degree of freedom, with their values by a regression of forces inside their bounds.

    Args:
        context: of the search.
        motion: in n instants.
        lacking: force on the degree of freedom that the model lacks there, (n,).
        v: its number.
    """
    speed = motion.qvel[:, v]
    does: dict[type[Effect], np.ndarray] = {
        JointDamping: -speed,
        JointFrictionloss: -np.sign(speed),
        JointArmature: -motion.qacc[:, v],
    }
    model = context.sim.model
    single = [c for c in context.candidates if c.kind in AT_EVERY_JOINT and c.target not in ("*", ACTUATED)]
    own = [c for c in single if model.joint(c.target).dofadr[0] == v]
    if not own or not speed.any():  # what never moves shows nothing
        return []
    columns = np.stack([does[c.kind] for c in own], 1)
    size, nominal = np.linalg.norm(columns, axis=0) + 1e-12, np.array([c.nominal[0] for c in own])
    low, high = (np.array([b[0] for b in ends]) - nominal for ends in zip(*(c.bounds() for c in own), strict=True))
    fit = lsq_linear(columns / size, lacking, (low * size - 1e-12, high * size + 1e-12))
    return [(c, np.array([x])) for c, x in zip(own, nominal + fit.x / size, strict=True)]

"""What every machine has at every joint, all at once: damping, dry friction and rotor inertia.

Where sensors are so good that a search one effect at a time ends nowhere
(:mod:`~idapt_pl.diagnosis.rounds.unexplained_forces`), it begins with these, as an engineer would, from what inverse
dynamics says of them; what is needless goes. Motors that two joints share are among them: where a joint's own friction
stands in for theirs, no search one effect at a time finds them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from idapt_pl.diagnosis.candidates.fit import split_parameters
from idapt_pl.diagnosis.rounds.revision import eliminate_needless, level
from idapt_pl.diagnosis.rounds.unexplained_forces import judge_by_forces, unexplained_forces
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState, refit_accepted
from idapt_pl.effects.base import ACTUATED, Effect, names_in
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.couplings import SharedMotor
from idapt_pl.effects.joints import JointArmature, JointDamping, JointFrictionloss
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.force_windows import MeasuredMotion, instants_of, lacking_forces, measured_motion

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
    found = causes_at_joints(context, motion, lacking)
    accepted = tuple(AcceptedEffect(k, c, x) for k, (c, x) in enumerate(found))
    with_all = replace(state, accepted=accepted)
    left = robust_deviation(lacking_forces(context.sim, with_all.effects, instants))
    size = np.maximum(np.minimum(unexplained_forces(context, state), left), ROOM * left)
    size = np.maximum(size, OF_THE_LARGEST * size.max() + 1e-12)
    with_all = refit_accepted(context, judge_by_forces(context, with_all, size))
    log.info("judged by forces, usual causes of all joints at once: held-out error %.3g", level(context, with_all))
    return eliminate_needless(context, with_all)


Cause = tuple[Candidate, np.ndarray]
"""A candidate with its parameters, (p,)."""


def causes_at_joints(context: SearchContext, motion: MeasuredMotion, lacking: np.ndarray) -> list[Cause]:
    """The usual causes of all joints, and motors that two joints share where these explain much more.

    Args:
        context: of the search.
        motion: in n instants.
        lacking: forces that the model lacks there, (n, nv).
    """
    model = context.sim.model
    found = {v: fit_forces(own_causes(context, v), model, motion, lacking) for v in range(model.nv)}
    for share, pair, together in sorted(shared_motors(context, motion, lacking, found), key=lambda x: x[0]):
        if share < 1 - SHARED_EXPLAINS and all(v in found for v in pair):
            log.info("%s: %.2g of the force (squared) is left", together[-1][0].label, share)
            found[model.nv + pair[1]] = together
            del found[pair[0]], found[pair[1]]
    return [cause for of_joint in found.values() for cause in of_joint]


def shared_motors(
    context: SearchContext, motion: MeasuredMotion, lacking: np.ndarray, found: Mapping[int, list[Cause]]
) -> Iterator[tuple[float, list[int], list[Cause]]]:
    """For each motor that two joints may share: the share of the force (squared) that is left with it, the two degrees
    of freedom, and their own causes with it.

    ``found`` are the own causes of every degree of freedom.
    """
    model = context.sim.model
    for c in context.candidates:
        if c.kind is not SharedMotor or "ratio" in c.names:
            continue
        pair = [int(model.joint(name).dofadr[0]) for name in names_in(c.target, joint_names(model))]
        own = [cause for v in pair for cause in found[v]]
        left = robust_deviation(lacking - forces_of(own, model, motion)) + 1e-12
        together = fit_forces([*(k for k, _ in own), c], model, motion, lacking, left)
        before, after = (unexplained_at(pair, model, motion, lacking / left, left, x) for x in (own, together))
        yield after / before, pair, together


def own_causes(context: SearchContext, v: int) -> list[Candidate]:
    """Candidates for the usual causes at a degree of freedom alone."""
    model = context.sim.model
    single = [c for c in context.candidates if c.kind in AT_EVERY_JOINT and c.target not in ("*", ACTUATED)]
    return [c for c in single if model.joint(c.target).dofadr[0] == v]


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Of all joints."""
    return [model.joint(j).name for j in range(model.njnt)]


def changes_of(c: Candidate, model: mujoco.MjModel, motion: MeasuredMotion) -> np.ndarray:
    """Forces on the degrees of freedom by what a candidate adds to its nominal values, (n, nv, p): they are linear."""
    ratio = getattr(c.effect(c.nominal), "ratio", 1.0)
    names = names_in(c.target, joint_names(model))
    turns = np.zeros(model.nv)  # how far each joint turns what rubs
    turns[[int(model.joint(name).dofadr[0]) for name in names]] = [ratio, 1.0][-len(names) :]
    speed, acceleration = motion.qvel @ turns, motion.qacc @ turns
    does = {"damping": -speed, "frictionloss": -np.sign(speed), "armature": -acceleration}
    return np.stack([does[name][:, None] * turns for name in c.names], -1)


def fit_forces(
    candidates: Sequence[Candidate], model: mujoco.MjModel, motion: MeasuredMotion, lacking: np.ndarray,
    size: np.ndarray | None = None,
) -> list[Cause]:  # fmt: skip
    """Candidates with values by a regression of forces inside their bounds; none of what never moves.

    Args:
        candidates: of one joint or more.
        model: the nominal one.
        motion: in n instants.
        lacking: forces, (n, nv).
        size: of what is left on each degree of freedom, which says how much each counts, (nv,); default all alike.
    """
    if not candidates:
        return []
    unit = np.ones(model.nv) if size is None else size
    columns = np.concatenate([changes_of(c, model, motion) for c in candidates], -1) / unit[:, None]
    touched = np.abs(columns).any((0, 2))
    A, y = columns[:, touched].reshape(-1, columns.shape[-1]), (lacking / unit)[:, touched].ravel()
    if not touched.any():  # what never moves shows nothing
        return []
    norm, nominal = np.linalg.norm(A, axis=0) + 1e-12, np.concatenate([c.nominal for c in candidates])
    low, high = (np.concatenate(ends) - nominal for ends in zip(*(c.bounds() for c in candidates), strict=True))
    fit = lsq_linear(A / norm, y, (low * norm - 1e-12, high * norm + 1e-12))
    values = nominal + fit.x / norm
    return list(zip(candidates, split_parameters(candidates, values), strict=True))


def forces_of(causes: Sequence[Cause], model: mujoco.MjModel, motion: MeasuredMotion) -> np.ndarray:
    """What causes add to the forces of the nominal model, (n, nv)."""
    added = [changes_of(c, model, motion) @ (x - np.array(c.nominal)) for c, x in causes]
    return np.sum(added, 0) if added else np.zeros(motion.qvel.shape)


def unexplained_at(
    dofs: Sequence[int], model: mujoco.MjModel, motion: MeasuredMotion, lacking: np.ndarray, size: np.ndarray,
    causes: Sequence[Cause],
) -> float:  # fmt: skip
    """Mean square of the force that causes leave on some degrees of freedom; both in units of ``size``, (nv,)."""
    return float(np.square((lacking - forces_of(causes, model, motion) / size)[:, list(dofs)]).mean()) + 1e-12

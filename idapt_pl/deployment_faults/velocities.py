"""Mends that make velocities agree with the positions: alternatives, of which forecasts choose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from idapt_pl.deployment_faults.forecast import Signals
from idapt_pl.deployment_faults.hypotheses import Hypothesis
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.kinematics import CLEAR, Agreement, changes, compare_velocities, correlate
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.deployment_faults.units import ANGLES, LENGTHS, SPEEDS, nearest_unit, usual_period

OTHER_PERIOD = 1.2
"""A common ratio of velocities and slopes further from 1 than this is no matter of sampling."""

ALIKE_RATIOS = 1.3
"""Ratios of all joints are taken to be one if none is further from their median than this factor."""

BETTER = 0.1
"""By how much more another slope must explain of a velocity for it to be out of order."""

LATEST_FILTER, LATEST_FILTER_STEPS = 0.05, 3
"""Velocities that come later than positions by less than so many seconds, or steps, may be filtered: no fault."""

Choose = Callable[[Sequence[Hypothesis]], list[Hypothesis]]
"""Those of several that are equally good by forecasts, the one to take first."""


def velocity_mend(
    mend: Mend, signals_of: Callable[[Mend], list[Signals]], joints: ScalarJoints, moving: list[int], choose: Choose
) -> tuple[Mend, list[tuple[str, str]]]:
    """What must be done so that velocities are slopes of positions; and what was taken for what else, in words.

    Args:
        mend: to begin with.
        signals_of: the recording under a mend.
        joints: of the model.
        moving: joints that move.
        choose: between alternatives that agree equally well.
    """
    others: list[tuple[str, str]] = []

    def decide(alternatives: list[Hypothesis]) -> Mend:
        best, *as_good = choose(alternatives)
        others.extend((best.words, h.words) for h in as_good)
        return best.mend

    found = compare_velocities(signals_of(mend), joints, moving)
    if alternatives := other_order(mend, found, joints, moving):
        mend = decide(alternatives)
        found = compare_velocities(signals_of(mend), joints, moving)
    if alternatives := one_factor(mend, found, joints, moving):
        mend = decide(alternatives)
        found = compare_velocities(signals_of(mend), joints, moving)
    for members in like_factors(found, joints, moving):
        mend = decide(own_factor(mend, found, joints, moving, members))
    signals = signals_of(mend)
    period = float(np.median(np.concatenate([np.diff(s.time) for s in signals])))
    return other_time(mend, compare_velocities(signals, joints, moving), joints, moving, period), others


def other_order(mend: Mend, found: Agreement, joints: ScalarJoints, moving: list[int]) -> list[Hypothesis]:
    """Velocities, or positions, in another order; nothing where they go along as they are."""
    squares = np.square(found.correlation)
    moved = [i for i in range(len(moving)) if found.partner[i] != i]
    if not moved or any(squares[i, found.partner[i]] < max(CLEAR**2, squares[i, i] + BETTER) for i in moved):
        return []
    of_velocities, of_positions = (list(range(len(joints))) for _ in range(2))
    for i in moved:
        j = int(found.partner[i])
        of_velocities[moving[j]] = moving[i]
        of_positions[moving[i]] = moving[j]
    return [
        Hypothesis("order of the velocities", mend.ordered_velocities(joints, of_velocities)),
        Hypothesis("order of the positions", mend.ordered_positions(joints, of_positions)),
    ]


def one_factor(mend: Mend, found: Agreement, joints: ScalarJoints, moving: list[int]) -> list[Hypothesis]:
    """A ratio that all joints have in common: the control period, or a unit."""
    common = common_ratio(found.ratio[found.clear])
    if common is None:
        return []
    made = [Hypothesis("control period", replace(mend, period=mend.period * usual_period(1 / common)))]
    velocities, positions = mend, mend
    for j in moving:
        v, q = factor_of_velocity(common, joints.hinge[j]), factor_of_position(common, joints.hinge[j])
        velocities = velocities.scaled_velocity(joints, j, v or 1.0)
        positions = positions.scaled_position(joints, j, q or 1.0)
    if velocities != mend:
        made.append(Hypothesis("unit of the velocities", velocities))
    if positions != mend:
        made.append(Hypothesis("unit of the positions", positions))
    return made


def common_ratio(ratios: np.ndarray) -> float | None:
    """What ratios of velocities and slopes (n,) have in common; None where they are about 1, or differ."""
    if not len(ratios) or (ratios < 0).any():
        return None
    common = float(np.median(ratios))
    if max(common, 1 / common) < OTHER_PERIOD or np.abs(np.log(ratios / common)).max() > np.log(ALIKE_RATIOS):
        return None
    return common


def floating_period(mend: Mend, signals: list[Signals], model: mujoco.MjModel) -> Mend:
    """The control period with which bodies that nothing holds go as fast as they say, where no joint tells it."""
    free = np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))
    q, v = ([int(at[j]) + k for j in free for k in range(3)] for at in (model.jnt_qposadr, model.jnt_dofadr))
    slope, speed = changes(signals, q, v, 0)
    clear = np.diag(correlate(slope, speed)) > CLEAR
    common = common_ratio(speed[:, clear].std(0) / slope[:, clear].std(0)) if clear.any() else None
    return mend if common is None else replace(mend, period=mend.period * usual_period(1 / common))


def like_factors(found: Agreement, joints: ScalarJoints, moving: list[int]) -> list[list[int]]:
    """Joints whose velocities or positions have another sign or unit; alike ones together, by number in ``moving``."""
    groups: dict[tuple, list[int]] = {}
    for n, j in enumerate(moving):
        ratio = float(found.ratio[n])
        factors = factor_of_velocity(abs(ratio), joints.hinge[j]), factor_of_position(abs(ratio), joints.hinge[j])
        turned = ratio < 0 and (any(factors) or 0.5 < abs(ratio) < 2)
        if found.clear[n] and (turned or any(factors)):
            groups.setdefault((turned, *factors), []).append(n)
    return list(groups.values())


def own_factor(
    mend: Mend, found: Agreement, joints: ScalarJoints, moving: list[int], members: list[int]
) -> list[Hypothesis]:
    """Sign or unit of velocities, or of positions, of some joints whose ratios are alike."""
    ratio, hinge = float(found.ratio[members[0]]), joints.hinge[moving[members[0]]]
    sign, made = float(np.sign(ratio)), []
    factors = {
        "velocity": factor_of_velocity(abs(ratio), hinge),
        "position": factor_of_position(abs(ratio), hinge),
    }
    for what, factor in factors.items():
        if factor is None and any(factors.values()):
            continue
        changed = mend
        for n in members:
            scale = changed.scaled_velocity if what == "velocity" else changed.scaled_position
            changed = scale(joints, moving[n], sign * (factor or 1.0))
        names = ", ".join(joints.names[moving[n]] for n in members)
        made.append(Hypothesis(f"{'unit' if factor else 'sign'} of the {what} of {names}", changed))
    return made


def factor_of_velocity(ratio: float, hinge: bool) -> float | None:
    """The unit's factor that takes a ratio of velocity and slope out of the velocity, if there is one."""
    near = nearest_unit(1 / ratio, SPEEDS if hinge else LENGTHS)
    return near[1] if near else None


def factor_of_position(ratio: float, hinge: bool) -> float | None:
    """Likewise out of the position."""
    near = nearest_unit(ratio, ANGLES if hinge else LENGTHS)
    return near[1] if near else None


def other_time(mend: Mend, found: Agreement, joints: ScalarJoints, moving: list[int], period: float) -> Mend:
    """Velocities that come too early, or much too late, moved to where the positions are; control period in s."""
    late, largest = list(mend.v_late), max(LATEST_FILTER_STEPS, LATEST_FILTER / period)
    shifts = {int(found.late[n]) for n in range(len(moving)) if found.clear[n]}
    everywhere = len(shifts) == 1  # joints that do not move share the clock
    for j in range(len(joints)) if everywhere else [j for n, j in enumerate(moving) if found.clear[n]]:
        s = shifts.copy().pop() if everywhere else int(found.late[moving.index(j)])
        if s < 0 or s >= largest:
            late[joints.v[j]] -= s
    return replace(mend, v_late=tuple(late))

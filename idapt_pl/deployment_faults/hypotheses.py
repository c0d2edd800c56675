"""What may be wrong with a recording: mends to try, each with the faults that it would take out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
from scipy.optimize import linear_sum_assignment

from idapt_pl.deployment_faults.commands import Influence
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.deployment_faults.units import ANGLES, FORCES, LENGTHS, SPEEDS, UNIT_TOLERANCE, nearest_unit

MOST_SWAPS = 36
"""Pairs of joints whose exchange is tried."""

OFFSETS = (0.25, -0.25, 0.5, -0.5, np.pi / 4, -np.pi / 4, np.pi / 2, -np.pi / 2, np.pi)
"""Errors of a joint's zero that are tried, rad; the nearest is then refined."""

SURE = 6.0
"""Standard errors from nothing at which an entry of the matrix of commands is taken to be there."""

CLEARLY_MORE = 1.5
"""An order is tried if commands make so many times more of the motion in it."""


NO_GAIN = 5.0
"""A factor of commands beyond this, or its inverse, is no matter of a motor's strength."""

LEAST_GRAVITY = 0.1
"""m/s²; with less, nothing can be said of its direction."""


@dataclass(frozen=True)
class Hypothesis:
    """A mend to try, and in words what would be wrong.

    Attributes:
        words: for "could also be".
        mend: all that is to be done, with what is certain already.
        offset_of: number of the joint whose offset is to be refined; None where nothing is.
    """

    words: str
    mend: Mend
    offset_of: int | None = None


def command_hypotheses(
    mend: Mend, found: Influence, model: mujoco.MjModel, joints: ScalarJoints
) -> Iterator[Hypothesis]:
    """What the matrix of commands suggests: another order, another sign, another unit."""
    order = strongest_commands(found)
    if order != list(range(model.nu)):
        yield Hypothesis("order of the commands", mend.ordered_commands(order))
        if (moved := order_of_joints(order, joints)) is not None:
            yield Hypothesis("order of the joints", mend.ordered_joints(joints, moved))
        return  # signs and units are read in the right order, in the next round
    strength = np.diag(found.matrix)
    certain = np.abs(strength) > SURE * np.diag(found.matrix_error)
    turned = [i for i in range(model.nu) if strength[i] < 0 and certain[i]]
    for i in turned:
        yield Hypothesis(f"sign of command {name_of(model, i)}", mend.scaled_command(i, -1.0))
    if len(turned) > 1:
        yield Hypothesis("sign of several commands", scaled_all(mend, dict.fromkeys(turned, -1.0)))
    measured = {i: abs(float(strength[i])) for i in range(model.nu) if certain[i]}
    yield from command_units(mend, model, measured)


def command_units(mend: Mend, model: mujoco.MjModel, measured: dict[int, float]) -> Iterator[Hypothesis]:
    """Units of commands by their measured strength: one that fits all, and of each the nearest."""
    known = {i: units_of_command(model, i) for i in measured}
    shared = set.intersection(*(set(u) for u in known.values())) if known else set()
    for name in sorted(shared):
        factors = {i: known[i][name] for i in known}
        off = [abs(np.log(measured[i] / f)) for i, f in factors.items()]
        if len(factors) > 1 and np.median(off) < np.log(UNIT_TOLERANCE) and max(off) < 3 * np.log(UNIT_TOLERANCE):
            every = {i: units_of_command(model, i).get(name, 1.0) for i in range(model.nu)}
            yield Hypothesis(f"unit of all commands ({name})", scaled_all(mend, every))
    for i, units in known.items():
        if near := nearest_unit(measured[i], units):
            yield Hypothesis(f"unit of command {name_of(model, i)} ({near[0]})", mend.scaled_command(i, near[1]))
    yield from plain_factors(mend, model, {i: f for i, f in measured.items() if not nearest_unit(f, known[i])})


def plain_factors(mend: Mend, model: mujoco.MjModel, measured: dict[int, float]) -> Iterator[Hypothesis]:
    """Factors of commands that are of no unit, such as a gear's, and too far from 1 to be a motor's gain."""
    far = {i: float(f"{f:.2g}") for i, f in measured.items() if abs(np.log(f)) > np.log(NO_GAIN)}
    common = float(f"{np.median(list(far.values())):.2g}") if far else 1.0
    if len(far) == model.nu > 1 and all(abs(np.log(f / common)) < np.log(UNIT_TOLERANCE) for f in far.values()):
        yield Hypothesis("unit of all commands (a factor)", scaled_all(mend, dict.fromkeys(far, common)))
    for i, factor in far.items():
        yield Hypothesis(f"unit of command {name_of(model, i)} (a factor)", mend.scaled_command(i, factor))


def strongest_commands(found: Influence) -> list[int]:
    """The command that drives each actuator; in the recorded order unless another is clearly better."""
    n = len(found.matrix)
    if n < 2:
        return list(range(n))
    _, order = linear_sum_assignment(-found.weight)
    moved = [i for i in range(n) if order[i] != i]
    sure = sum(abs(found.matrix[i, order[i]]) > SURE * found.matrix_error[i, order[i]] for i in moved)
    better = found.weight[moved, order[moved]].sum() > CLEARLY_MORE * found.weight[moved, moved].sum()
    return [int(j) for j in order] if moved and better and sure > len(moved) / 2 else list(range(n))


def order_of_joints(commands: Sequence[int], joints: ScalarJoints) -> list[int] | None:
    """The order of joints that looks like this order of commands; None where joints and actuators are no pairs."""
    joint_of = {a[0]: j for j, a in enumerate(joints.actuators) if len(a) == 1}
    if any(i not in joint_of or c not in joint_of for i, c in enumerate(commands) if i != c):
        return None
    order = list(range(len(joints)))
    for i, c in enumerate(commands):
        if i != c:
            order[joint_of[c]] = joint_of[i]
    return order if all(joints.hinge[j] == joints.hinge[k] for j, k in enumerate(order)) else None


def units_of_command(model: mujoco.MjModel, i: int) -> dict[str, float]:
    """Units that an actuator's commands may have been written in, with their factors."""
    servo = int(model.actuator_biastype[i]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    units = dict(SPEEDS if servo else FORCES)
    gear = abs(float(model.actuator_gear[i, 0]))
    if not servo and (gear > 5 or 0 < gear < 0.2):
        units["force behind the gear"] = 1 / gear
    return units | {f"{name}, the other way": 1 / f for name, f in units.items()}


def joint_hypotheses(
    mend: Mend, model: mujoco.MjModel, joints: ScalarJoints, moving: Sequence[int], span: np.ndarray
) -> Iterator[Hypothesis]:
    """Signs, order and units of joints, with their commands as they are or turned alike.

    Args:
        mend: what is certain already.
        model: the nominal model.
        joints: of it.
        moving: joints that move.
        span: from the lowest to the highest position of each joint, as mended so far, (joints,).
    """
    for j in moving:
        turned = mend.scaled_joint(joints, j, -1.0)
        yield Hypothesis(f"sign of joint {joints.names[j]}", turned)
        if joints.actuators[j]:
            with_commands = scaled_all(turned, dict.fromkeys(joints.actuators[j], -1.0))
            yield Hypothesis(f"sign of joint {joints.names[j]} and of its command", with_commands)
    yield from swaps(mend, joints, moving)
    yield from joint_units(mend, joints, moving, span)


def swaps(mend: Mend, joints: ScalarJoints, moving: Sequence[int]) -> Iterator[Hypothesis]:
    """Two joints exchanged, and two joints exchanged along with their commands."""
    pairs = [(a, b) for a, b in combinations(moving, 2) if joints.hinge[a] == joints.hinge[b]]
    for a, b in pairs if len(pairs) <= MOST_SWAPS else ():
        order = list(range(len(joints)))
        order[a], order[b] = b, a
        exchanged = mend.ordered_joints(joints, order)
        words = f"order of joints {joints.names[a]} and {joints.names[b]}"
        yield Hypothesis(words, exchanged)
        if len(joints.actuators[a]) == 1 == len(joints.actuators[b]):
            commands = list(range(len(mend.u_order)))
            (i,), (k,) = joints.actuators[a], joints.actuators[b]
            commands[i], commands[k] = k, i
            yield Hypothesis(f"{words} and of their commands", exchanged.ordered_commands(commands))


def joint_units(mend: Mend, joints: ScalarJoints, moving: Sequence[int], span: np.ndarray) -> Iterator[Hypothesis]:
    """Joints in another unit, one by one and all that can be at once."""
    for hinge, units in ((True, ANGLES), (False, LENGTHS)):
        for name, factor in units.items():
            fitting = [j for j in moving if joints.hinge[j] == hinge and plausible(span[j], factor)]
            for j in fitting:
                yield Hypothesis(f"unit of joint {joints.names[j]} ({name})", mend.scaled_joint(joints, j, factor))
            if len(fitting) > 1:
                every = mend
                for j in fitting:
                    every = every.scaled_joint(joints, j, factor)
                yield Hypothesis(f"unit of all joints ({name})", every)


def plausible(span: float, factor: float) -> bool:
    """Whether a joint may have moved so far that it was written down with this span."""
    return 0.02 < span * factor < 4 * np.pi and (factor > 1 or span > 1.0)


def offset_hypotheses(mend: Mend, joints: ScalarJoints, moving: Sequence[int]) -> Iterator[Hypothesis]:
    """The zero of a hinge elsewhere."""
    for j in moving:
        for by in OFFSETS if joints.hinge[j] else ():
            yield Hypothesis(f"zero of joint {joints.names[j]}", mend.moved_joint(joints, j, float(by)), j)


def gravity_hypotheses(mend: Mend, model: mujoco.MjModel) -> Iterator[Hypothesis]:
    """The base turned by 90 or 180 degrees: gravity along another axis of the model, either way."""
    size, now = float(np.linalg.norm(model.opt.gravity)), model.opt.gravity
    if size < LEAST_GRAVITY or mend.gravity is not None:
        return
    for axis in range(3):
        for way in (1.0, -1.0):
            turned = way * size * np.eye(3)[axis]
            if turned @ now < 0.9 * size**2:
                yield Hypothesis("direction of gravity", replace(mend, gravity=tuple(float(x) + 0.0 for x in turned)))


def scaled_all(mend: Mend, factors: dict[int, float]) -> Mend:
    """Commands of several actuators multiplied."""
    for i, f in factors.items():
        mend = mend.scaled_command(i, f)
    return mend


def name_of(model: mujoco.MjModel, i: int) -> str:
    """An actuator's name."""
    return model.actuator(i).name or f"actuator{i}"


def first_of_each(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses without those whose mend was there before."""
    return list({h.mend: h for h in reversed(list(hypotheses))}.values())[::-1]

"""A mend taken apart: the faults in it, and for each the mend without it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from idapt_pl.deployment_faults.fault import DeploymentFault, FaultKind
from idapt_pl.deployment_faults.hypotheses import name_of
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.mend import Mend, put


@dataclass(frozen=True)
class FaultPart:
    """One fault of a mend.

    Attributes:
        fault: what it is.
        without: the mend without its cure.
        by_forecast: whether forecasts alone tell it; else velocities and positions do.
    """

    fault: DeploymentFault
    without: Mend
    by_forecast: bool


def faults_of(mend: Mend, model: mujoco.MjModel, measured: bool, period: float = 1.0) -> list[FaultPart]:
    """All faults that a mend takes out.

    Args:
        mend: to be taken apart.
        model: the nominal model.
        measured: whether velocities were measured; where not, a mend of a position is one of the joint.
        period: control period of the recording as it is, s.
    """
    joints = ScalarJoints.of(model)
    return [
        *period_part(mend),
        *order_parts(mend, model, joints, measured),
        *scale_parts(mend, joints, measured),
        *command_scale_parts(mend, model),
        *zero_parts(mend, joints),
        *clock_parts(mend, model, joints, period),
        *drive_parts(mend, model),
        *gravity_part(mend),
    ]


def period_part(mend: Mend) -> Iterator[FaultPart]:
    """The control period."""
    if mend.period != 1.0:
        fault = DeploymentFault(FaultKind.CONTROL_PERIOD, ("*",), mend.period)
        yield FaultPart(fault, replace(mend, period=1.0), False)


def order_parts(mend: Mend, model: mujoco.MjModel, joints: ScalarJoints, measured: bool) -> Iterator[FaultPart]:
    """Orders of joints, of positions and velocities alone, and of commands."""
    q = [joints.q.index(mend.q_order[i]) for i in joints.q]
    v = [joints.v.index(mend.v_order[i]) for i in joints.v]
    usual = list(range(len(joints)))
    plain = replace(mend, q_order=tuple(range(len(mend.q_order)))), tuple(range(len(mend.v_order)))
    if q == v or not measured:
        if q != usual:
            without = replace(plain[0], v_order=plain[1])
            yield FaultPart(reordered(FaultKind.JOINT_ORDER, q, joints.names), without, True)
    else:
        if q != usual:
            yield FaultPart(reordered(FaultKind.POSITION_ORDER, q, joints.names), plain[0], False)
        if v != usual:
            without = replace(mend, v_order=plain[1])
            yield FaultPart(reordered(FaultKind.VELOCITY_ORDER, v, joints.names), without, False)
    if list(mend.u_order) != list(range(model.nu)):
        names = tuple(name_of(model, i) for i in range(model.nu))
        without = replace(mend, u_order=tuple(range(model.nu)))
        yield FaultPart(reordered(FaultKind.COMMAND_ORDER, mend.u_order, names), without, True)


def reordered(kind: FaultKind, order: Sequence[int], names: Sequence[str]) -> DeploymentFault:
    """The fault that columns are in another order: which, and the names of those that hold them."""
    moved = [i for i, j in enumerate(order) if i != j]
    return DeploymentFault(kind, tuple(names[i] for i in moved), tuple(names[order[i]] for i in moved))


def scale_parts(mend: Mend, joints: ScalarJoints, measured: bool) -> Iterator[FaultPart]:
    """Signs and units of joints, or of positions and velocities alone; equal ones are one fault."""
    groups: dict[tuple[str, str, float], list[int]] = {}
    for j in range(len(joints)):
        q, v = mend.q_scale[joints.q[j]], mend.v_scale[joints.v[j]]
        if not measured:
            v = q
        for how, a, b in (("sign", np.sign(q), np.sign(v)), ("unit", abs(q), abs(v))):
            both = abs(np.log(abs(a / b))) < 1e-9 and a * b > 0
            for what, factor in (("joint", a),) if both else (("position", a), ("velocity", b)):
                if factor != 1.0:
                    groups.setdefault((what, how, float(factor)), []).append(j)
    for (what, how, factor), members in groups.items():
        without = mend
        for j in members:
            if what != "velocity":
                i = joints.q[j]
                without = replace(without, q_scale=put(without.q_scale, i, without.q_scale[i] / factor))
            if what != "position":
                without = without.scaled_velocity(joints, j, 1 / factor)
        names = tuple(joints.names[j] for j in members)
        yield FaultPart(DeploymentFault(FaultKind(f"{what}_{how}"), names, factor), without, what == "joint")


def command_scale_parts(mend: Mend, model: mujoco.MjModel) -> Iterator[FaultPart]:
    """Signs and units of commands; equal ones are one fault."""
    groups: dict[tuple[str, float], list[int]] = {}
    for i, scale in enumerate(mend.u_scale):
        for how, factor in (("sign", float(np.sign(scale))), ("unit", abs(scale))):
            if factor != 1.0:
                groups.setdefault((how, factor), []).append(i)
    for (how, factor), members in groups.items():
        without = mend
        for i in members:
            without = without.scaled_command(i, 1 / factor)
        names = tuple(name_of(model, i) for i in members)
        yield FaultPart(DeploymentFault(FaultKind(f"command_{how}"), names, factor), without, True)


def zero_parts(mend: Mend, joints: ScalarJoints) -> Iterator[FaultPart]:
    """Zeros of joints, in the model's units."""
    for j, name in enumerate(joints.names):
        i = joints.q[j]
        if mend.q_offset[i]:
            fault = DeploymentFault(FaultKind.JOINT_ZERO, (name,), round(mend.q_offset[i], 4), "rad")
            yield FaultPart(fault, replace(mend, q_offset=put(mend.q_offset, i, 0.0)), True)


def clock_parts(mend: Mend, model: mujoco.MjModel, joints: ScalarJoints, period: float) -> Iterator[FaultPart]:
    """Shifts in time of commands, and of velocities against positions; all that are alike are one fault."""
    dt = period * mend.period
    names = tuple(name_of(model, i) for i in range(model.nu))
    for late in sorted({*mend.u_late} - {0}):
        members = [i for i, s in enumerate(mend.u_late) if s == late]
        where = ("*",) if len(members) == model.nu else tuple(names[i] for i in members)
        left = tuple(0 if s == late else s for s in mend.u_late)
        fault = DeploymentFault(FaultKind.COMMAND_CLOCK, where, round(late * dt, 6), "s")
        yield FaultPart(fault, replace(mend, u_late=left), True)
    for late in sorted({mend.v_late[i] for i in joints.v} - {0}):
        members = [j for j, i in enumerate(joints.v) if mend.v_late[i] == late]
        where = ("*",) if len(members) == len(joints) else tuple(joints.names[j] for j in members)
        left = tuple(0 if s == late else s for s in mend.v_late)
        fault = DeploymentFault(FaultKind.VELOCITY_CLOCK, where, round(late * dt, 6), "s")
        yield FaultPart(fault, replace(mend, v_late=left), False)


def drive_parts(mend: Mend, model: mujoco.MjModel) -> Iterator[FaultPart]:
    """Drives of another kind than in the model."""
    changed = [i for i, d in enumerate(mend.drives) if d is not None]
    if not changed:
        return
    drives = [d for d in mend.drives if d is not None]
    names = tuple(name_of(model, i) for i in changed)
    servos = any(d[1] for d in drives)
    kind = FaultKind.SERVO_AS_MOTOR if servos else FaultKind.MOTOR_AS_SERVO
    told = tuple(f"kp {d[0]:.3g} kv {-d[2]:.3g}" if servos else "gain 1" for d in drives)
    yield FaultPart(DeploymentFault(kind, names, told), replace(mend, drives=()), True)


def gravity_part(mend: Mend) -> Iterator[FaultPart]:
    """Gravity along another axis."""
    if mend.gravity is not None:
        told = tuple(f"{g:.4g}" for g in mend.gravity)
        yield FaultPart(
            DeploymentFault(FaultKind.GRAVITY_TURNED, ("*",), told, "m/s²"), replace(mend, gravity=None), True
        )

"""The effects a diagnosis considers: what, where, from which nominal value, in which steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mujoco
import numpy as np

from idapt_pl.diagnosis.data import Recording
from idapt_pl.effects.actuators import (
    ActuatorBias,
    ActuatorDeadzone,
    ActuatorGain,
    ActuatorKp,
    ActuatorKv,
    ActuatorRotation,
    ActuatorSaturation,
    MotorConstant,
)
from idapt_pl.effects.base import ACTUATED, Effect
from idapt_pl.effects.bodies import BodyCom, BodyInertia, BodyMass, Payload
from idapt_pl.effects.candidate import Candidate, TypicalSizes
from idapt_pl.effects.contacts import ContactFriction, ContactSoftness
from idapt_pl.effects.joints import (
    JointArmature,
    JointBacklash,
    JointCogging,
    JointDamping,
    JointDrag,
    JointFrictionloss,
    JointSpringref,
    JointStiffness,
    JointStribeck,
)
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag, SensorBias, SensorGain
from idapt_pl.effects.world import ExternalForce, FluidDrag, GravityDirection, Numerics

JOINT = mujoco.mjtTrn.mjTRN_JOINT

PERIODS = (2, 4, 6, 8, 12)
"""Of cogging torques, in a revolution."""

REPEATS = 1.5
"""How many periods of a cogging torque the recordings must show: less than that is any torque that bends with angle."""

SENSOR_GAIN = ((0.8, 1.25),)
"""Position sensors are off by per cents; a larger scale imitates inertia and gravity."""

FURTHER = {JointFrictionloss: (0.3, 1.0, 3.0, 10.0, 30.0), JointArmature: (0.3, 1.0, 3.0)}
"""Where fits of joints' effects start too, in scales from nominal. What sticks shows little of a small change;
and where first velocities are poorly known, a little more rotor inertia makes things worse before much more mends
them."""


def typical_sizes(model: mujoco.MjModel, data: list[Recording], horizon: float) -> TypicalSizes:
    """Measure them."""
    d, inertia, force = mujoco.MjData(model), [], []
    for r in data[:8]:
        for k in np.linspace(0, len(r.actions) - 1, 9).astype(int):
            d.qpos[:], d.qvel[:], d.ctrl[:] = r.qpos[k], r.qvel[k], r.actions[k]
            mujoco.mj_forward(model, d)
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, d, full)
            inertia.append(np.diag(full))
            force.append(d.actuator_force.copy())
    speed = np.sqrt(np.mean(np.concatenate([np.square(r.qvel) for r in data]), 0))
    positions = np.concatenate([r.qpos for r in data])
    motion, widest = np.ones(model.nv), np.zeros(model.nv)
    for j in range(model.njnt):
        if model.jnt_type[j] >= 2:
            of_joint = positions[:, model.jnt_qposadr[j]]
            motion[model.jnt_dofadr[j]], widest[model.jnt_dofadr[j]] = of_joint.std(), np.ptp(of_joint)
    actions = np.concatenate([r.actions for r in data])
    command = np.sqrt(np.mean(np.square(actions), 0)) if model.nu else np.zeros(0)
    dt = float(np.median(np.concatenate([np.diff(r.time) for r in data])))
    tiny = 1e-9
    inertia, force = np.median(inertia, 0), np.sqrt(np.mean(np.square(force), 0))
    usual = (inertia, speed, motion, widest, command, force)
    return TypicalSizes(dt, *(u + tiny for u in usual), horizon)


def all_candidates(spec: mujoco.MjSpec, around: TypicalSizes) -> list[Candidate]:
    """Every candidate for a model, single ones and those of all elements of a kind."""
    model = spec.copy().compile()
    found: list[Candidate] = []
    for make in (_joints, _bodies, _actuators, _contacts, _world):
        found += make(model, around)
    return found


def _shared(singles: list[Candidate], target: str = "*") -> list[Candidate]:
    """One value for all of a kind, where their nominal values agree."""
    if len(singles) < 2 or len({c.nominal for c in singles}) > 1:
        return []
    scale = tuple(np.median([c.scale for c in singles], 0))
    return [dataclasses.replace(singles[0], target=target, scale=scale)]


def _joints(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] >= 2]
    rows: list[tuple[type[Effect], str, Callable[[int], float], Callable[[int], float]]] = [
        (JointDamping, "damping", lambda v: model.dof_damping[v], lambda v: a.inertia[v] / a.horizon),
        (
            JointFrictionloss,
            "frictionloss",
            lambda v: model.dof_frictionloss[v],
            lambda v: a.inertia[v] * a.speed[v] / a.horizon,
        ),
        (JointArmature, "armature", lambda v: model.dof_armature[v], lambda v: a.inertia[v]),
        (JointDrag, "drag", lambda v: 0.0, lambda v: a.inertia[v] / a.horizon / a.speed[v]),
    ]
    on_joints = [i for i in range(model.nu) if model.actuator_trntype[i] == JOINT]
    driven = {model.jnt_dofadr[model.actuator_trnid[i, 0]] for i in on_joints}
    names_driven = {model.joint(j).name for j in hinges if model.jnt_dofadr[j] in driven}
    found = []
    for kind, parameter, nominal, scale in rows:
        singles = []
        for j in hinges:
            v = model.jnt_dofadr[j]
            n, s = float(nominal(v)), float(scale(v))
            starts = tuple((n + f * s,) for f in FURTHER.get(kind, ()))
            singles.append(Candidate(kind, model.joint(j).name, (parameter,), (n,), (s,), starts))
        of_motors = [c for c in singles if c.target in names_driven]  # the joints of a free base are of another kind
        found += singles + (_shared(singles) or _shared(of_motors, ACTUATED))
    springs, rests = [], []
    for j in hinges:
        v, q, name = model.jnt_dofadr[j], model.jnt_qposadr[j], model.joint(j).name
        stiffness = float(model.jnt_stiffness[j])
        springs.append(Candidate(JointStiffness, name, ("stiffness",), (stiffness,), (a.inertia[v] / a.horizon**2,)))
        if stiffness:
            rests.append(
                Candidate(JointSpringref, name, ("springref",), (float(model.qpos_spring[q]),), (a.motion[v],))
            )
        found.append(Candidate(SensorBias, name, ("bias",), (0.0,), (a.motion[v],)))
        found.append(Candidate(SensorGain, name, ("gain",), (1.0,), (0.2,), span=SENSOR_GAIN))
        torque = a.inertia[v] * a.speed[v] / a.horizon
        found.append(
            Candidate(
                JointStribeck,
                name,
                ("coulomb", "static", "speed"),
                (0.0, 0.0, a.speed[v] / 4),
                (torque, torque, a.speed[v] / 4),
                span=((0.0, 1e6), (0.0, 1e6), (a.speed[v] / 50, 10 * a.speed[v])),  # slower is plain dry friction
                strength=2,
                starts=tuple(
                    (c * torque, s * torque, f * a.speed[v]) for c, s in ((0.1, 0.2), (0.3, 1.0)) for f in (0.05, 0.3)
                ),
            )
        )
        if v in driven:
            starts = tuple((f * a.motion[v],) for f in (0.03, 0.15))
            found.append(Candidate(JointBacklash, name, ("width",), (0.0,), (0.1 * a.motion[v],), starts))
        if model.jnt_type[j] == 3:
            for periods in (p for p in PERIODS if a.range[v] * p / (2 * np.pi) > REPEATS):
                found.append(
                    Candidate(
                        JointCogging,
                        name,
                        ("sine", "cosine"),
                        (0.0, 0.0),
                        (torque, torque),
                        fixed=(("periods", float(periods)),),
                    )
                )
    return found + springs + _shared(springs) + rests


def _bodies(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    found = []
    for b in range(1, model.nbody):
        name, mass = model.body(b).name, float(model.body(b).mass[0])
        if not name or mass <= 0 or not moves(model, b):
            continue
        found.append(
            Candidate(
                BodyMass,
                name,
                ("mass",),
                (mass,),
                (mass,),
                starts=tuple((mass * f,) for f in (0.3, 2.0, 5.0, 15.0, 40.0)),
            )
        )
        reach = 0.3 * float(np.sqrt(model.body(b).inertia.max() / mass)) + 1e-3
        found.append(Candidate(BodyCom, name, ("x", "y", "z"), (0.0,) * 3, (reach,) * 3))
        found.append(
            Candidate(
                Payload,
                name,
                ("mass", "x", "y", "z"),
                (0.0,) * 4,
                (mass, *(3 * reach,) * 3),
                starts=((0.2 * mass, 0.0, 0.0, 0.0), (0.2 * mass, 3 * reach, 0.0, 3 * reach)),
                strength=1,
            )
        )
        found.append(
            Candidate(
                BodyInertia,
                name,
                ("mass", "rotation", "x", "y", "z", "xx", "yy", "xy", "xz", "yz"),
                (1.0, 1.0, *(0.0,) * 8),
                (0.5, 0.5, *(reach,) * 3, *(0.5,) * 5),
            )
        )
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and model.body(b).name and moves(model, b)]
    weight = float(np.median(a.inertia)) * float(np.median(a.speed)) / a.horizon + 0.05 * float(model.body_mass.sum())
    return found + [
        Candidate(ExternalForce, model.body(b).name, ("x", "y", "z"), (0.0,) * 3, (weight,) * 3) for b in roots
    ]


def moves(model: mujoco.MjModel, b: int) -> bool:
    """Whether any joint moves a body."""
    while b:
        if model.body_dofnum[b]:
            return True
        b = model.body_parentid[b]
    return False


def _actuators(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    found: list[Candidate] = []
    limits = np.abs(
        np.concatenate([[0.0], model.actuator_ctrlrange[model.actuator_ctrllimited.astype(bool)].ravel()])
    ).max()
    widest = float(limits or 3 * a.command.max(initial=1.0))
    rows = [
        (ActuatorGain, "gain", 1.0, lambda i: 0.3, lambda i: ((0.5,), (2.0,))),
        (ActuatorBias, "bias", 0.0, lambda i: 0.5 * a.command[i], lambda i: ()),
        (
            ActuatorDeadzone,
            "width",
            0.0,
            lambda i: 0.3 * a.command[i],
            lambda i: tuple((f * a.command[i],) for f in (0.2, 0.6)),
        ),
        (ActuatorDelay, "delay", 0.0, lambda i: a.dt, lambda i: tuple((f * a.dt,) for f in (0.5, 1.0, 2.0, 4.0))),
        (
            ActuatorSaturation,
            "limit",
            widest,
            lambda i: 0.5 * a.command[i],
            lambda i: tuple((f * a.command[i],) for f in (0.5, 1.0, 1.4)),
        ),
    ]
    for kind, parameter, nominal, scale, starts in rows:
        singles = [
            Candidate(kind, model.actuator(i).name, (parameter,), (nominal,), (float(scale(i)),), starts=starts(i))
            for i in range(model.nu)
            if model.actuator(i).name
        ]
        found += singles + _shared(singles)
    h = float(model.opt.timestep)
    lags = [
        Candidate(
            ActuatorLag,
            model.actuator(i).name,
            ("time_constant", "dead_time"),
            (0.0, 0.0),
            (a.dt, h),
            starts=tuple((f * a.dt, 0.0) for f in (0.3, 1.0, 3.0)),
            span=((0.0, 10.0), (-h, h)),  # beyond a time step it is a delay of its own
            strength=1,
        )
        for i in range(model.nu)
        if model.actuator(i).name
    ]
    return found + lags + _shared(lags) + _servos(model, a)


def _servos(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    """Gains of servos and constants of motors, and what crossed wires do."""
    names = [model.actuator(i).name for i in range(model.nu)]
    dc = [i for i in range(model.nu) if model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_DCMOTOR]
    others = [i for i in range(model.nu) if i not in dc]
    servos = [i for i in others if model.actuator_biasprm[i, 1]]
    # where a joint is driven, velocity feedback is its damping by another name; but only feedback can be taken away
    fed_back = [i for i in others if model.actuator_biasprm[i, 2] < 0 or model.actuator_trntype[i] != JOINT]
    stiff = [
        Candidate(ActuatorKp, names[i], ("factor",), (1.0,), (0.3,), starts=((0.3,), (0.1,), (2.0,))) for i in servos
    ]
    weak = []
    for i in servos:  # a motor's force is its command, a servo's is not
        widest = float(model.actuator_forcerange[i, 1] if model.actuator_forcelimited[i] else 10 * a.force[i])
        starts = tuple((f * a.force[i],) for f in (0.5, 1.0, 1.6))
        weak.append(Candidate(ActuatorSaturation, names[i], ("force",), (widest,), (0.5 * a.force[i],), starts=starts))
    constant = [Candidate(MotorConstant, names[i], ("factor",), (1.0,), (0.3,)) for i in dc]
    feedback = []
    for i in fed_back:
        kv = max(0.0, -float(model.actuator_biasprm[i, 2]))
        feedback.append(Candidate(ActuatorKv, names[i], ("kv",), (kv,), (kv or 0.1,), starts=((0.3 * kv,),)))
    crossed = [
        Candidate(ActuatorRotation, f"{names[i]} {names[i + 1]}", ("angle",), (0.0,), (0.3,), starts=((1.57,),))
        for i in range(model.nu - 1)
    ]
    named = [c for c in (*stiff, *weak, *constant, *feedback) if c.target]
    return named + [s for kind in (stiff, constant, feedback) for s in _shared(kind)] + crossed


def _contacts(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    touching = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    if len(touching) < 2:
        return []
    slide = float(max(model.geom_friction[g, 0] for g in touching))
    soft = float(model.geom_solref[touching[0], 0])
    found = [
        Candidate(
            ContactFriction,
            "*",
            ("sliding",),
            (slide,),
            (0.3 * slide + 0.05,),
            starts=((0.3 * slide,), (0.6 * slide,), (1.7 * slide,)),
        ),
    ]
    if soft > 0:
        found.append(
            Candidate(
                ContactSoftness,
                "*",
                ("time_constant",),
                (soft,),
                (0.5 * soft,),
                starts=((0.5 * soft,), (2.5 * soft,)),
            )
        )
    for g in touching:
        # of two geoms the larger friction counts: less of one alone shows only where it had more than the other
        if model.geom(g).name:
            own = float(model.geom_friction[g, 0])
            found.append(
                Candidate(
                    ContactFriction,
                    model.geom(g).name,
                    ("sliding",),
                    (own,),
                    (0.3 * own + 0.05,),
                    starts=((0.4 * own,), (2.0 * own,)) if own == slide else ((2.0 * slide,),),
                )
            )
    return found


def _world(model: mujoco.MjModel, a: TypicalSizes) -> list[Candidate]:
    found = [
        Candidate(
            FluidDrag,
            "world",
            ("density",),
            (float(model.opt.density),),
            (100.0,),
            fixed=(("viscosity", float(model.opt.viscosity)),),
        ),
        Candidate(
            FluidDrag,
            "world",
            ("viscosity",),
            (float(model.opt.viscosity),),
            (1.0,),
            fixed=(("density", float(model.opt.density)),),
        ),
    ]
    if np.linalg.norm(model.opt.gravity) > 0 and abs(model.opt.gravity[2]) > 0.99 * np.linalg.norm(model.opt.gravity):
        for one, other in (("tilt_x", "tilt_y"), ("tilt_y", "tilt_x")):  # a planar machine feels one of them alone
            found.append(Candidate(GravityDirection, "world", (one,), (0.0,), (0.1,), fixed=((other, 0.0),)))
        found.append(Candidate(GravityDirection, "world", ("tilt_x", "tilt_y"), (0.0, 0.0), (0.1, 0.1)))
    return found


def numerics_candidates(model: mujoco.MjModel) -> list[Numerics]:
    """Other ways to integrate the same equations, finest last."""
    h = float(model.opt.timestep)
    return [
        Numerics("world", timestep=h / f, integrator=how)
        for f, how in ((1, "implicitfast"), (1, "RK4"), (5, "implicitfast"))
    ]

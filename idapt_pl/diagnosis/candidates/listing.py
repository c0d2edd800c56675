"""What a diagnosis tries: the candidates of all effects, with scales from the recordings, and other numerics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from idapt_pl.diagnosis.candidates.held_joints import joints_held
from idapt_pl.effects import EFFECTS
from idapt_pl.effects.base import ACTUATED, names_in
from idapt_pl.effects.candidate import Candidate, TypicalSizes
from idapt_pl.effects.plausible import Machine, with_plausible_ends
from idapt_pl.effects.world import Numerics
from idapt_pl.prediction.data import Recording

CANDIDATE_ORDER = """
joint_damping
joint_frictionloss
joint_armature
joint_drag
sensor_bias sensor_gain joint_stribeck joint_backlash joint_cogging
joint_stiffness
joint_springref
joint_range
shared_motor
body_mass body_com payload body_inertia
external_force
actuator_gain
actuator_bias
actuator_deadzone
actuator_curve
actuator_delay
actuator_saturation.limit
actuator_lag
actuator_kp
actuator_saturation.force
motor_constant
motor_resistance
motor_strength
actuator_kv
actuator_kp(*)
motor_constant(*)
motor_resistance(*)
motor_strength(*)
actuator_kv(*)
actuator_rotation
contact_friction(*)
contact_softness
contact_friction
fluid_drag
gravity_direction
"""
"""Which of two candidates with the same score comes first. Effects in one line go element by element; ``(*)`` is one
value for all elements, ``.limit`` the candidate with that parameter. Effects that are not here come last."""


def typical_sizes(model: mujoco.MjModel, data: list[Recording], horizon: float) -> TypicalSizes:
    """Typical sizes in recordings of a model.

    Args:
        model: the nominal one.
        data: its recordings; inertia and forces are taken at nine samples of each of the first eight.
        horizon: how long predictions run, s.
    """
    d, inertia, force, effort = mujoco.MjData(model), [], [], []
    for r in data[:8]:
        for k in np.linspace(0, len(r.actions) - 1, 9).astype(int):
            d.qpos[:], d.qvel[:], d.ctrl[:] = r.qpos[k], r.qvel[k], r.actions[k]
            mujoco.mj_forward(model, d)
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, d, full)
            inertia.append(np.diag(full))
            force.append(d.actuator_force.copy())
            effort.append(np.abs(d.qfrc_actuator) + np.abs(d.qfrc_bias) + np.abs(d.qfrc_passive))
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
    inertia, usual = np.median(inertia, 0), np.sqrt(np.mean(np.square(force), 0))
    sizes = TypicalSizes(
        dt, inertia + tiny, speed + tiny, motion + tiny, widest + tiny, command + tiny, usual + tiny, horizon
    )
    spreads = {"command_spread": np.abs(actions).std(0) + tiny, "force_spread": np.abs(force).std(0) + tiny}
    return replace(sizes, effort=np.max(effort, 0) + sizes.torque, **spreads)


def all_candidates(spec: mujoco.MjSpec, typical: TypicalSizes) -> list[Candidate]:
    """Every candidate of every effect for a model, in :data:`CANDIDATE_ORDER`; none on joints that are held."""
    model, held = spec.copy().compile(), joints_held(spec)
    if held and (model.jnt_type >= 2).sum() - len(held) < 2:
        held |= {"*", ACTUATED}  # one value for all would be that of the only joint left
    every = [c for kind in EFFECTS.values() for c in kind.candidates(model, typical)]
    names = [model.joint(j).name for j in range(model.njnt)]
    on_joints = {c for c in every if c.kind.phrase.endswith(("joint", "joints"))}
    of_held = {c for c in on_joints if held.intersection((c.target, *names_in(c.target, names)))}
    return in_order([c for c in every if c not in of_held])


def in_plausible_ranges(
    model: mujoco.MjModel, typical: TypicalSizes, candidates: Sequence[Candidate]
) -> list[Candidate]:
    """The candidates of a model, each with what is plausible for it."""
    machine = Machine(model, typical)
    return [with_plausible_ends(c, machine) for c in candidates]


def in_order(candidates: list[Candidate]) -> list[Candidate]:
    """The candidates in :data:`CANDIDATE_ORDER`."""
    lines = [line.split() for line in CANDIDATE_ORDER.strip().splitlines()]
    places = {entry: (i, k) for i, line in enumerate(lines) for k, entry in enumerate(line)}

    def place(c: Candidate) -> tuple[int, int]:
        entries = (c.label, f"{c.kind.name}.{c.names[0]}", c.kind.name)
        return next((places[e] for e in entries if e in places), (len(lines), 0))

    by_effect = sorted(candidates, key=place)
    elements: dict[tuple[int, str], int] = {}
    for c in by_effect:
        elements.setdefault((place(c)[0], c.target), len(elements))
    return sorted(by_effect, key=lambda c: (place(c)[0], elements[place(c)[0], c.target]))


def numerics_candidates(model: mujoco.MjModel) -> list[Numerics]:
    """Ways to integrate the same equations other than the model's own, finest last."""
    h = float(model.opt.timestep)
    own = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower()
    return [
        Numerics("world", timestep=h / f, integrator=how)
        for f, how in ((1, "implicitfast"), (1, "RK4"), (5, "implicitfast"))
        if (f, how.lower()) != (1, own)
    ]

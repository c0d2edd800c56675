"""A crawler that is drawn at random: a trunk on a floor, in the plane, moved by legs whose feet slip and bounce."""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.drawn.hidden import ON_A_FLOOR
from benchmarks.drawn.machine import INTEGRATORS, Machine, Rng

ROOT = ("root_x", "root_z", "root_pitch")
"""Coordinates of the trunk, which no motor moves."""
ABOVE = (0.005, 0.05)
"""How far above the floor the lowest point begins, m."""


def draw_crawler(rng: Rng) -> Machine:
    """A trunk with one to three legs on a floor."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.option.timestep = "crawler", float(rng.choice([0.001, 0.002, 0.004]))
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{rng.choice(INTEGRATORS)}")
    floor = {"contype": 1, "conaffinity": 0, "size": [0, 0, 1], "friction": [rng.uniform(0.6, 1.2), 0.005, 1e-4]}
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, **floor)
    trunk, length, mass = add_trunk(spec, rng)
    legs = int(rng.integers(1, 4))
    load = 0.2 * 9.81 * mass / legs
    for i in range(legs):
        add_leg(trunk, i, length * (0.0 if legs == 1 else i / (legs - 1) - 0.5), rng)
    model = spec.compile()
    for j, inertia in zip(spec.joints[len(ROOT) :], model.dof_M0[len(ROOT) :], strict=True):
        j.damping[0] = inertia * rng.uniform(1.0, 4.0) + load / rng.uniform(20.0, 50.0)
        j.armature = inertia * rng.uniform(0.1, 0.6)
    add_drives(spec, spec.compile(), load, rng)
    steps = round(float(rng.choice([0.01, 0.02])) / spec.option.timestep)
    return Machine(spec, steps, put_on_floor, ON_A_FLOOR, len(ROOT))


def add_trunk(spec: mujoco.MjSpec, rng: Rng) -> tuple[mujoco.MjsBody, float, float]:
    """A box that moves in the plane; its length, m, and its mass, kg."""
    length, mass = rng.uniform(0.2, 0.6), float(np.exp(rng.uniform(np.log(1.0), np.log(8.0))))
    trunk = spec.worldbody.add_body(name="trunk")
    kinds = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    for name, kind, axis in zip(ROOT, kinds, ([1, 0, 0], [0, 0, 1], [0, 1, 0]), strict=True):
        trunk.add_joint(name=name, type=kind, axis=axis)
    box = {"size": [length / 2, 0.08, rng.uniform(0.03, 0.08)], "mass": mass, "contype": 0, "conaffinity": 1}
    trunk.add_geom(name="trunk", type=mujoco.mjtGeom.mjGEOM_BOX, **box)
    return trunk, length, mass


def add_leg(trunk: mujoco.MjsBody, i: int, at: float, rng: Rng) -> None:
    """One or two rods on hinges, the second at the end of the first."""
    parent, where = trunk, [at, 0.0, 0.0]
    for k in range(int(rng.integers(1, 3))):
        name, long, thick = f"leg{i}_{k}", rng.uniform(0.12, 0.3), rng.uniform(0.015, 0.03)
        parent = parent.add_body(name=name, pos=where)
        joint = parent.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0])
        joint.limited, joint.range = 1, np.degrees([-1, 1] * rng.uniform(0.8, 2.0, 2))
        rod = {"fromto": [0, 0, 0, 0, 0, -long], "size": [thick, 0, 0], "mass": rng.uniform(0.1, 0.6)}
        parent.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, contype=0, conaffinity=1, **rod)
        where = [0.0, 0.0, -long]


def add_drives(spec: mujoco.MjSpec, model: mujoco.MjModel, load: float, rng: Rng) -> None:
    """A motor or servo for every joint of a leg, strong enough for a torque that its load asks for, N m."""
    kind = rng.choice(["motor", "position", "position"])
    for v in range(len(ROOT), model.nv):
        inertia, target = float(model.dof_M0[v]), model.joint(v).name
        a = spec.add_actuator(name=target, target=target, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrllimited=1)
        if kind == "motor":
            a.set_to_motor()
            a.gear[0] = rng.uniform(1, 30)
            full = (20 * inertia + load) / a.gear[0]
        else:
            stiff = inertia * rng.uniform(8, 25) ** 2 + load / rng.uniform(0.2, 0.5)
            a.set_to_position(kp=stiff, kv=stiff * rng.uniform(0.02, 0.1))
            full = 0.8
        a.ctrlrange = [-full, full]


def put_on_floor(model: mujoco.MjModel, data: mujoco.MjData, rng: Rng) -> None:
    """Legs somewhere, the trunk nearly level, the lowest point a little above the floor."""
    data.qpos[:] = rng.uniform(-0.5, 0.5, model.nq)
    data.qpos[: len(ROOT)] = 0.0, 1.0, 0.2 * rng.normal()
    mujoco.mj_kinematics(model, data)
    heights = [data.geom_xpos[g, 2] - reach_down(model, data, g) for g in range(1, model.ngeom)]
    data.qpos[1] += rng.uniform(*ABOVE) - min(heights)


def reach_down(model: mujoco.MjModel, data: mujoco.MjData, g: int) -> float:
    """How far a box or a capsule reaches below its middle, m."""
    size, down = model.geom_size[g], np.abs(data.geom_xmat[g].reshape(3, 3)[2])
    return float(size @ down if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX else size[0] + size[1] * down[2])

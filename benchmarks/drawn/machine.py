"""A mechanism that is drawn at random, and how it moves with something hidden in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.drawn.hidden import KINDS, Hidden, Kind

INTEGRATORS = ("EULER", "IMPLICITFAST", "IMPLICITFAST", "RK4")
HELD = 8
"""Control steps for which a random command is held."""
Rng = np.random.Generator


@dataclass(frozen=True)
class Machine:
    """A mechanism, and what is particular about it.

    Attributes:
        spec: its model.
        steps: time steps in its control period.
        begin: puts it where an episode begins.
        kinds: of what may be hidden in it.
        first_joint: the first with something of its own; those before are a trunk's way through the world.
    """

    spec: mujoco.MjSpec
    steps: int
    begin: Callable[[mujoco.MjModel, mujoco.MjData, Rng], None]
    kinds: Sequence[Kind]
    first_joint: int = 0

    @property
    def period(self) -> float:
        """Control period, s."""
        return self.steps * self.spec.option.timestep


def anywhere(model: mujoco.MjModel, data: mujoco.MjData, rng: Rng) -> None:
    """Joints somewhere around zero, moving."""
    data.qpos[:] = rng.uniform(-0.5, 0.5, model.nq)
    data.qvel[:] = 0.3 * rng.normal(size=model.nv)


def draw_machine(rng: Rng) -> Machine:
    """A mechanism without contacts."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.option.timestep = "drawn", float(rng.choice([0.001, 0.002, 0.004]))
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{rng.choice(INTEGRATORS)}")
    links, n = [spec.worldbody], int(rng.integers(2, 6))
    for i in range(n):
        cart = i == 0 and rng.random() < 0.4
        parent = links[-1] if rng.random() < 0.8 or i == 0 else links[rng.integers(1, len(links))]
        links.append(add_link(parent, i, cart, rng))
    model = spec.compile()
    for j, inertia in zip(spec.joints, model.dof_M0, strict=True):
        j.damping[0] = inertia * rng.uniform(0.1, 2.0)
        j.armature = inertia * rng.uniform(0.0, 0.4)
        j.frictionloss = inertia * rng.uniform(0.1, 1.0) if rng.random() < 0.3 else 0.0
    add_motors(spec, spec.compile(), rng)
    steps = round(float(rng.choice([0.01, 0.02, 0.04])) / spec.option.timestep)
    return Machine(spec, steps, anywhere, KINDS)


def add_link(parent: mujoco.MjsBody, i: int, cart: bool, rng: Rng) -> mujoco.MjsBody:
    """A box on a slide, or a rod on a hinge at the end of its parent's."""
    rod = next(iter(parent.geoms), None)
    at = rod.fromto[3:] if rod is not None and np.isfinite(rod.fromto[0]) else np.zeros(3)
    body = parent.add_body(name=f"link{i}", pos=at)
    axis = np.eye(3)[rng.integers(2 if cart else 3)]
    kind = mujoco.mjtJoint.mjJNT_SLIDE if cart else mujoco.mjtJoint.mjJNT_HINGE
    joint = body.add_joint(name=f"joint{i}", type=kind, axis=axis)
    if not cart and rng.random() < 0.5:
        joint.limited, joint.range = 1, np.degrees([-1, 1] * rng.uniform(1.0, 2.5, 2))
    mass = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))) * 0.8**i
    off = {"contype": 0, "conaffinity": 0, "mass": mass}
    if cart:
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=rng.uniform(0.05, 0.15, 3), **off)
    else:
        along = rng.normal(size=3) - np.array([0, 0, 1.5])
        along -= 0.7 * axis * (along @ axis)  # a rod along its own axis swings nothing
        end = along / np.linalg.norm(along) * rng.uniform(0.15, 0.5)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *end], size=[rng.uniform(0.02, 0.05), 0, 0], **off
        )
    return body


def add_motors(spec: mujoco.MjSpec, model: mujoco.MjModel, rng: Rng) -> None:
    """A motor or servo for most joints, as strong as the joint asks for."""
    usual = rng.choice(["motor", "motor", "position", "velocity"])
    driven = np.flatnonzero(rng.random(model.nv) < 0.85)
    for v in driven if len(driven) else [0]:
        kind = usual if rng.random() < 0.8 else rng.choice(["motor", "position", "velocity"])
        name, inertia, rate = f"joint{v}", float(model.dof_M0[v]), rng.uniform(8, 25)
        a = spec.add_actuator(name=f"motor{v}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrllimited=1)
        if kind == "motor":
            gear = rng.uniform(1, 30)
            a.set_to_motor()
            a.gear[0], full = gear, (inertia * rng.uniform(10, 40) + weight_on(model, v)) / gear
        elif kind == "position":
            a.set_to_position(kp=inertia * rate**2, kv=inertia * rate * rng.uniform(0.6, 2.0))
            full = 0.8
        else:
            a.set_to_velocity(kv=inertia * rate)
            full = 4.0
        a.ctrlrange = [-full, full]


def weight_on(model: mujoco.MjModel, v: int) -> float:
    """The torque or force by which gravity acts on a coordinate where joints are at zero."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return abs(float(data.qfrc_bias[v]))


def with_hidden(spec: mujoco.MjSpec, hidden: Sequence[Hidden]) -> mujoco.MjModel:
    """The true model."""
    model = spec.compile()
    for h in hidden:
        h.change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def play(
    model: mujoco.MjModel, data: mujoco.MjData, commands: np.ndarray, steps: int, hidden: Sequence[Hidden]
) -> np.ndarray:
    """States (T+1, nq + nv) under commands (T, nu), each for some time steps; before the first there are none."""
    dt, late = model.opt.timestep, sum(h.delay for h in hidden)
    kept = [1 - np.exp(-dt / h.lag) for h in hidden if h.lag]
    filtered, out = np.zeros((len(kept), model.nu)), [np.concatenate([data.qpos, data.qvel])]
    for k in range(len(commands) * steps):
        at = int(np.floor((k + 0.5 - late / dt) / steps))
        u = commands[at] if at >= 0 else np.zeros(model.nu)
        for h in hidden:
            u = h.command(u)
        for f, share in zip(filtered, kept, strict=True):
            f += share * (u - f)
            u = f
        data.ctrl[:] = u
        data.qfrc_applied[:] = sum(h.force(data.qpos, data.qvel) for h in hidden)
        mujoco.mj_step(model, data)
        if (k + 1) % steps == 0:
            out.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(out)


def random_commands(model: mujoco.MjModel, period: float, steps: int, k: int, rng: Rng) -> np.ndarray:
    """Commands of the k-th episode, (steps, nu), within three quarters of their range: held, or sums of sines."""
    if k % 2:
        shape = rng.uniform(-0.75, 0.75, (-(-steps // HELD), model.nu)).repeat(HELD, 0)[:steps]
    else:
        time, nu = period * np.arange(steps)[:, None], model.nu
        waves = [np.sin(2 * np.pi * rng.uniform(0.3, 3, nu) * time + rng.uniform(0, 6.3, nu)) for _ in range(3)]
        shape = np.clip(0.4 * sum(waves), -0.75, 0.75)
    return (shape * model.actuator_ctrlrange[:, 1]).astype(np.float32)

"""Forces of laws that MJCF has no words for, in simulations side by side or in one that an environment steps."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from idapt_pl.effects.base import ACTUATED, PLAY_SUFFIX, Effect
from idapt_pl.effects.driven import joints_of_actuators
from idapt_pl.effects.learned import JointSignals, SignalForce
from idapt_pl.effects.own_signals import arriving_commands
from idapt_pl.effects.runtime import ForceEffect


@dataclass(frozen=True)
class MotionNow:
    """Where n simulations are.

    Attributes:
        qpos, qvel: (n, nq), (n, nv).
        commands: as they arrive at the motors from now on, after delays and filters, (n, nu).
        activation: of actuators with states, (n, na).
        time: s since each episode began, (n,).
    """

    qpos: np.ndarray
    qvel: np.ndarray
    commands: np.ndarray
    activation: np.ndarray
    time: np.ndarray


class ActingForces:
    """Laws on the joints of a model.

    Args:
        model: compiled.
        effects: of which those with laws count.
    """

    def __init__(self, model: mujoco.MjModel, effects: Sequence[Effect]) -> None:
        self.model, self.at_once = model, without_delays(model)
        self.scratch = mujoco.MjData(self.at_once)
        pairs = [(e, j) for e in effects if isinstance(e, SignalForce) for j in joints_meant(model, e.target)]
        self.pairs: list[tuple[SignalForce, int]] = pairs
        self.memories = sum(e.memories for e, _ in pairs)
        self.driven = not pairs or any("motor" in e.signals for e, _ in pairs)
        self.loaded = any(e.signals & {"motor", "load"} for e, _ in pairs)

    def signals(self, now: MotionNow) -> list[JointSignals]:
        """What each law on each joint sees."""
        motor, load = self.loads(now) if self.loaded else (None, None)
        return [joint_signals(self.model, j, now, motor, load) for _, j in self.pairs]

    def loads(self, now: MotionNow) -> tuple[np.ndarray, np.ndarray]:
        """Forces of actuators, and of gravity and motion, on all degrees of freedom, (n, nv) each."""
        d, m = self.scratch, self.at_once
        motor, load = np.zeros_like(now.qvel), np.zeros_like(now.qvel)
        for i in range(len(now.qvel)):  # no more of mj_forward than it takes
            d.qpos, d.qvel = now.qpos[i], now.qvel[i]
            mujoco.mj_kinematics(m, d)
            mujoco.mj_comPos(m, d)
            mujoco.mj_tendon(m, d)
            mujoco.mj_transmission(m, d)
            mujoco.mj_fwdVelocity(m, d)
            load[i] = d.qfrc_bias
            if self.driven:
                d.ctrl = now.commands[i]
                if m.na:
                    d.act = now.activation[i]
                mujoco.mj_fwdActuation(m, d)
                motor[i] = d.qfrc_actuator
        return motor, load

    def remember(
        self, before: list[JointSignals], now: list[JointSignals], memory: np.ndarray, seconds: float | np.ndarray
    ) -> np.ndarray:
        """The memory of all laws after a step, (n, memories)."""
        if not self.memories:
            return memory
        parts = zip(self.pairs, before, now, self.split(memory), strict=True)
        return np.concatenate([e.remember(b, a, m, seconds) for (e, _), b, a, m in parts], -1)

    def forces(self, signals: list[JointSignals], memory: np.ndarray) -> np.ndarray:
        """What the laws add, (n, nv)."""
        out = np.zeros((len(memory), self.model.nv))
        for (effect, j), seen, own in zip(self.pairs, signals, self.split(memory), strict=True):
            out[:, self.model.jnt_dofadr[j]] += effect.force_from(seen, own)
        return out

    def split(self, memory: np.ndarray) -> list[np.ndarray]:
        """The memory of each law on each joint."""
        return np.split(memory, np.cumsum([e.memories for e, _ in self.pairs])[:-1], -1)


def without_delays(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model, or a copy in which commands act at once: those that laws are given have arrived."""
    if not (model.actuator_delay > 0).any():
        return model
    model = copy.copy(model)
    model.actuator_delay[:] = 0
    return model


def joints_meant(model: mujoco.MjModel, target: str) -> list[int]:
    """Hinges and slides that a target means."""
    scalar = [j for j in range(model.njnt) if model.jnt_type[j] >= 2 and not model.joint(j).name.endswith(PLAY_SUFFIX)]
    meant = {"*": set(scalar), ACTUATED: joints_of_actuators(model)}.get(target)
    return [j for j in scalar if (model.joint(j).name == target if meant is None else j in meant)]


def joint_signals(
    model: mujoco.MjModel, joint: int, now: MotionNow, motor: np.ndarray | None, load: np.ndarray | None
) -> JointSignals:
    """What a law on a joint may see; ``motor`` and ``load`` (n, nv) where they were computed."""
    q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    seen = {"q": now.qpos[:, q], "v": now.qvel[:, v], "t": now.time}
    acting = actuators_on(model, joint)
    seen["u"] = now.commands[:, acting[0]] if acting else np.zeros(len(now.time))
    if motor is not None and load is not None:
        seen |= {"motor": motor[:, v], "load": load[:, v]}
    return seen


def actuators_on(model: mujoco.MjModel, joint: int) -> list[int]:
    """Actuators that act on a joint; ``u`` is the command of the first."""
    at_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    return np.flatnonzero(at_joint).tolist()


# --- in an environment ------------------------------------------------------------------------------------

_LAWS: WeakKeyDictionary[mujoco.MjModel, tuple[ForceEffect, ...]] = WeakKeyDictionary()
_ACTING: WeakKeyDictionary[mujoco.MjData, _InOneSimulation] = WeakKeyDictionary()
"""Models and simulations do not carry effects, and tasks know neither domains nor laws: so they are looked up."""


def register_laws(model: mujoco.MjModel, effects: Sequence[Effect]) -> None:
    """Let :func:`advance` add the force laws among some effects to a model's simulations."""
    laws = tuple(e for e in effects if isinstance(e, ForceEffect))
    if laws:
        _LAWS[model] = laws


def has_laws(model: mujoco.MjModel) -> bool:
    """Whether force laws are registered for a model."""
    return model in _LAWS


def advance(model: mujoco.MjModel, data: mujoco.MjData, steps: int = 1) -> None:
    """``mj_step``, with the laws that are registered for the model."""
    laws = _LAWS.get(model)
    if laws is None:
        mujoco.mj_step(model, data, steps)
        return
    acting = _ACTING.get(data)
    if acting is None:
        acting = _ACTING[data] = _InOneSimulation(model, laws)
    for _ in range(steps):
        acting.step(data)


class _InOneSimulation:
    """Laws in one simulation. Those that remember forget when the clock goes back, as after a reset."""

    def __init__(self, model: mujoco.MjModel, laws: tuple[ForceEffect, ...]) -> None:
        self.model, self.acting = model, ActingForces(model, laws)
        plain = [e for e in laws if not isinstance(e, SignalForce)]
        self.on_bodies = [(e, model.body(e.target).id) for e in plain if e.acts_on == "bodies"]
        joints = [(e, joints_meant(model, e.target)) for e in plain if e.acts_on == "joints"]
        self.on_joints = [(e, model.jnt_qposadr[j], model.jnt_dofadr[j]) for e, j in joints]
        self.time = np.inf
        self.before: list[JointSignals] = []
        self.memory = np.zeros((1, self.acting.memories))

    def step(self, data: mujoco.MjData) -> None:
        held, pulled = data.qfrc_applied.copy(), data.xfrc_applied.copy()
        if self.acting.pairs:
            data.qfrc_applied[:] += self.by_signals(data)
        now = np.array([data.time])
        for effect, q, v in self.on_joints:
            data.qfrc_applied[v] += effect.force(data.qpos[q][None], data.qvel[v][None], now)[0]
        for effect, body in self.on_bodies:
            data.xfrc_applied[body, :3] += effect.force(data.qpos[None], data.qvel[None], now)[0]
        mujoco.mj_step(self.model, data)
        data.qfrc_applied[:], data.xfrc_applied[:] = held, pulled

    def by_signals(self, data: mujoco.MjData) -> np.ndarray:
        """What laws that look at signals add now, (nv,)."""
        qpos, qvel, activation = (np.array(x)[None] for x in (data.qpos, data.qvel, data.act))
        now = MotionNow(qpos, qvel, arriving_commands(self.model, data)[None], activation, np.array([data.time]))
        signals = self.acting.signals(now)
        if data.time < self.time + 1e-12 and data.time != self.time:
            self.memory[:] = 0.0
        elif self.before:
            self.memory = self.acting.remember(self.before, signals, self.memory, self.model.opt.timestep)
        self.before, self.time = signals, data.time
        return self.acting.forces(signals, self.memory)[0]

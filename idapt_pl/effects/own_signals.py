"""Delays and filters that a model's actuators have themselves, as effects on commands.

A replay may begin anywhere in a recording. What is then under way to a motor, or in its filter, is not measured; but it
follows from the commands before, which are.
"""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects.runtime import CommandEffect
from idapt_pl.effects.signals import FILTERS, ActuatorDelay, ActuatorLag


def take_signals(spec: mujoco.MjSpec) -> tuple[mujoco.MjSpec, tuple[CommandEffect, ...]]:
    """A copy of a model whose actuators act at once, and what they did to commands before; they all have names."""
    taken, spec = own_signals(spec, spec.option.timestep), spec.copy()
    for actuator in spec.actuators:
        if actuator.nsample:
            actuator.delay, actuator.nsample = 0.0, 0
        if actuator.dyntype in FILTERS:
            actuator.dyntype, actuator.actlimited = mujoco.mjtDyn.mjDYN_NONE, False
    return spec, taken


def own_signals(spec: mujoco.MjSpec, step: float) -> tuple[CommandEffect, ...]:
    """What a model's actuators do to commands themselves, in a simulation with such time steps [s]."""
    own = list[CommandEffect]()
    for actuator in spec.actuators:
        if actuator.nsample and actuator.delay > 0:
            own.append(ActuatorDelay(actuator.name, float(actuator.delay)))
        if actuator.dyntype in FILTERS:
            # a step's force follows from the filter's state when it begins, or when it ends
            late = (-0.5 if actuator.actearly else 0.5) * step
            own.append(ActuatorLag(actuator.name, exact_time_constant(actuator, step), late))
    return tuple(own)


def exact_time_constant(actuator: mujoco.MjsActuator, step: float) -> float:
    """Time constant [s] with which an exact filter does in a step [s] what an actuator's filter does."""
    lag = float(actuator.dynprm[0])
    if actuator.dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT or lag <= step:
        return lag
    return float(-step / np.log1p(-step / lag))


def arriving_commands(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """What the next step's forces come from, (nu,): commands after the model's delays, and filters' states."""
    out = data.ctrl.copy()
    for i in np.flatnonzero(model.actuator_delay > 0):
        mujoco.mj_readCtrl(model, data, int(i), data.time, read := np.zeros((1, 1)), -1)
        out[i] = read[0, 0]
    filters = np.flatnonzero(np.isin(model.actuator_dyntype, FILTERS))
    at, early = model.actuator_actadr[filters], model.actuator_actearly[filters].astype(bool)
    lag, h = model.actuator_dynprm[filters, 0], model.opt.timestep
    exact = model.actuator_dyntype[filters] == mujoco.mjtDyn.mjDYN_FILTEREXACT
    share = np.where(exact, -np.expm1(-h / np.maximum(lag, mujoco.mjMINVAL)), h / np.maximum(lag, mujoco.mjMINVAL))
    out[filters] = data.act[at] + early * share * (out[filters] - data.act[at])
    return out


def commanded_activations(model: mujoco.MjModel, commands: np.ndarray) -> np.ndarray:
    """States of a model's actuators that have followed their commands, (n, nu) to (n, na)."""
    out, one = np.zeros((len(commands), model.na)), np.flatnonzero(model.actuator_actnum == 1)
    out[:, model.actuator_actadr[one]] = commands[:, one].clip(*activation_ranges(model, one))
    return out


def first_activations(model: mujoco.MjModel, qpos: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """States that a model's actuators may have where replays begin: (n, nq) and (n, nu) to (n, na).

    An integrator, whose state is the set-point of a servo, is where its joint is; others are at their command.
    """
    out, servos = commanded_activations(model, commands), integrators(model)
    if not len(servos):
        return out
    ranges, data = activation_ranges(model, servos), mujoco.MjData(model)
    for row, q in zip(out, qpos, strict=True):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        row[model.actuator_actadr[servos]] = data.actuator_length[servos].clip(*ranges)
    return out


def integrated_commands(model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """States of a model's actuators at every sample of an episode, (T + 1, na), those of integrators by their commands.

    They begin where their joints are: a machine rests before a recording does not.

    Args:
        model: with actuators that have states.
        time: of the samples, s, (T + 1,).
        qpos: positions at them, (T + 1, nq); the first counts.
        commands: held from one to the next, (T or T + 1, nu).
    """
    steps, servos = len(time) - 1, integrators(model)
    out = np.zeros((steps + 1, model.na))
    out[:] = first_activations(model, qpos[:1], commands[:1])
    at, (low, high) = model.actuator_actadr[servos], activation_ranges(model, servos)
    for k, dt in enumerate(np.diff(time)):
        out[k + 1, at] = (out[k, at] + dt * commands[k, servos]).clip(low, high)
    return out


def integrators(model: mujoco.MjModel) -> np.ndarray:
    """Numbers of the actuators whose state is the integral of their command."""
    return np.flatnonzero((model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR) & (model.actuator_actnum == 1))


def activation_ranges(model: mujoco.MjModel, actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest states of some actuators, (k,) each; infinite where they are not limited."""
    limited = model.actuator_actlimited[actuators, None].astype(bool)
    low, high = np.where(limited, model.actuator_actrange[actuators], [-np.inf, np.inf]).T
    return low, high

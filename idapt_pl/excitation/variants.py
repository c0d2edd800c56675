"""Explanations with other values than those known: a motion must be safe on a machine that is not quite the model."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects.actuators import ActuatorGain, ActuatorKp, dc_motors, servos
from idapt_pl.effects.base import PLAY_SUFFIX, Effect
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.candidate import mechanical_joints, moved_bodies, named_actuators
from idapt_pl.effects.joints import JointDamping, JointFrictionloss
from idapt_pl.effects.world import Numerics
from idapt_pl.prediction.simulator import Effects

FRICTION_SPREAD, MASS, STRENGTH = 0.3, 0.1, 0.1
"""Shares by which friction and damping, masses, and what actuators do may be off."""


def varied(model: mujoco.MjModel, effects: Effects, rng: np.random.Generator) -> Effects:
    """The effects of an explanation, and others that put friction, masses and actuators a little off.

    Args:
        model: compiled with the effects.
        effects: of the explanation.
        rng: of the values.
    """
    changed: list[Effect] = []

    def about(value: float, share: float) -> float:
        return float(value * rng.uniform(1 - share, 1 + share))

    for _, v, name in mechanical_joints(model):
        if not name or name.endswith(PLAY_SUFFIX):
            continue
        if model.dof_damping[v]:
            changed.append(JointDamping(name, about(model.dof_damping[v], FRICTION_SPREAD)))
        if model.dof_frictionloss[v]:
            changed.append(JointFrictionloss(name, about(model.dof_frictionloss[v], FRICTION_SPREAD)))
    changed += [BodyMass(name, about(model.body_mass[b], MASS)) for b, name in moved_bodies(model)]
    position, motors = servos(model), dc_motors(model)
    for i, name in named_actuators(model):
        if i not in motors:
            kind = ActuatorKp if i in position else ActuatorGain
            changed.append(kind(name, about(1.0, STRENGTH)))
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:  # explicit in damping, so more of it may blow up
        changed.append(Numerics("world", float(model.opt.timestep), "implicitfast"))
    return (*effects, *changed)

"""In which units a model's actuators are told what to do."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects.actuators import linear_actuators

UNITS = {"force": ("N·m", "N"), "position": ("rad", "m"), "velocity": ("rad/s", "m/s")}
"""Of a hinge and of a slide, by what a command is."""


def action_units(model: mujoco.MjModel) -> list[str]:
    """The unit of each actuator's command, such as ``N·m``, ``× 100 N`` or ``rad``; empty where none is known.

    Motors, position servos and velocity servos on a hinge or a slide have one. Through a gear it is multiplied.
    """
    known = set(linear_actuators(model))
    return [unit_of(model, i) if i in known else "" for i in range(model.nu)]


def unit_of(model: mujoco.MjModel, i: int) -> str:
    """The same of one actuator, whose force is linear in command, position and velocity."""
    joint, gear, kind = int(model.actuator_trnid[i, 0]), float(model.actuator_gear[i, 0]), told_what(model, i)
    if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT or not gear or kind is None:
        return ""
    slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    if not slide and model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        return ""
    unit = UNITS[kind][int(slide)]
    factor = float(model.actuator_gainprm[i, 0]) * gear if kind == "force" else 1 / gear
    return unit if np.isclose(factor, 1) else f"× {factor:.4g} {unit}"


def told_what(model: mujoco.MjModel, i: int) -> str | None:
    """Whether an actuator is told a force, a position or a velocity; None for what is none of them."""
    gain, (_, kp, kv) = model.actuator_gainprm[i, 0], -model.actuator_biasprm[i, :3]
    integrated = model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR
    if gain and np.isclose(kp, gain):
        return "velocity" if integrated else "position"
    if kp or integrated:
        return None
    return "velocity" if gain and np.isclose(kv, gain) else "force"

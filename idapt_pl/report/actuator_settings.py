"""The repaired model's drives in the terms of an Isaac-style actuator config: what can be derived, and what cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.effects.signals import FILTERS, ActuatorLag, SensorDelay
from idapt_pl.effects.world import Numerics
from idapt_pl.prediction.simulator import Effects
from idapt_pl.report.changed_settings import effects_at_ends

TERMS = {
    "stiffness": "N·m/rad or N/m",
    "damping": "N·m·s/rad or N·s/m",
    "armature": "kg·m² or kg",
    "friction": "N·m or N",
    "effort_limit": "N·m or N",
    "delay": "s",
}
"""Terms and their units, of hinges or slides."""

SAID = ("joint_damping", "joint_frictionloss", "joint_armature", "actuator_kp", "actuator_kv", "motor_strength",
        "actuator_delay", "actuator_saturation")  # fmt: skip
"""Effects that these terms say in full."""

PLAIN = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
"""Laws of motors and of servos."""

ELSEWHERE = ("body_mass", "body_com", "body_inertia", "payload", "gravity_direction", "contact_friction",
             "contact_softness", "numerics", "fluid_drag", "joint_range")  # fmt: skip
"""Effects that other parts of a simulation say: bodies and their joints' ends, contacts, the world."""


@dataclass(frozen=True)
class DriveSettings:
    """One joint that an actuator drives.

    Attributes:
        joint: its name.
        values: by term; terms that cannot be derived are left out.
        intervals: 95 %, of those that were found to differ.
        servo: whether commands are positions; else they are efforts.
    """

    joint: str
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    servo: bool


def drive_settings(diagnosis: Diagnosis) -> tuple[list[DriveSettings], list[str]]:
    """Drives of the repaired model, and in words what these terms do not say."""
    now = drives_of(diagnosis, diagnosis.effects)
    ends = [drives_of(diagnosis, effects) for effects in effects_at_ends(diagnosis)]
    made = []
    for joint, (values, servo) in now.items():
        intervals = {}
        for term, value in values.items():
            every = [value, *(e[joint][0].get(term, value) for e in ends if joint in e)]
            if max(every) - min(every) > 1e-9 * max(abs(value), 1e-12):
                intervals[term] = (min(every), max(every))
        made.append(DriveSettings(joint, values, intervals, servo))
    return made, left_unsaid(diagnosis, made)


def drives_of(diagnosis: Diagnosis, effects: Effects) -> dict[str, tuple[dict[str, float], bool]]:
    """Of each joint that one actuator drives: its terms, and whether commands are positions."""
    spec = diagnosis.sim.spec.copy()
    for effect in effects:
        effect.apply(spec)
    model = spec.compile()
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    found = {}
    for j in range(model.njnt):
        drives = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == j))
        if len(drives) == 1 and model.jnt_type[j] >= 2:
            values, servo = terms_of(model, j, int(drives[0]))
            if late := float(model.actuator_delay[drives[0]]) + sensor_delay(effects):
                values["delay"] = late
            found[model.joint(j).name] = values, servo
    return found


def terms_of(model: mujoco.MjModel, j: int, i: int) -> tuple[dict[str, float], bool]:
    """Terms of joint j under actuator i; a servo's feedback of velocity and the joint's own damping are added."""
    dof, gear = model.jnt_dofadr[j], float(model.actuator_gear[i, 0])
    affine = model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
    servo = bool(affine and model.actuator_biasprm[i, 1])
    values = {
        "stiffness": -float(model.actuator_biasprm[i, 1]) * gear**2 if affine else 0.0,
        "damping": float(np.ravel(model.dof_damping[dof])[0])
        + (-float(model.actuator_biasprm[i, 2]) * gear**2 if affine else 0.0),
        "armature": float(model.dof_armature[dof]),
        "friction": float(model.dof_frictionloss[dof]),
    }
    limits = []
    if model.actuator_forcelimited[i]:
        limits.append(float(np.abs(model.actuator_forcerange[i]).max() * abs(gear)))
    if model.jnt_actfrclimited[j]:
        limits.append(float(np.abs(model.jnt_actfrcrange[j]).max()))
    fixed = model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED
    if not servo and fixed and model.actuator_ctrllimited[i]:
        limits.append(float(np.abs(model.actuator_ctrlrange[i]).max() * abs(gear * model.actuator_gainprm[i, 0])))
    if limits:
        values["effort_limit"] = min(limits)
    return values, servo


def sensor_delay(effects: Effects) -> float:
    """By how much all measurements are late, s, which the compiled model does not have."""
    return float(sum(e.delay for e in effects if isinstance(e, SensorDelay)))


def own_dynamics(spec: mujoco.MjSpec) -> list[str]:
    """What the nominal model's actuators do that the terms do not say, in words."""
    told = [
        f"{a.name}: a first-order filter of {a.dynprm[0]:.3g} s on the commands, which the model has anyway"
        for a in spec.actuators if a.dyntype in FILTERS
    ]  # fmt: skip
    odd = [
        a.name for a in spec.actuators if a.biastype not in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
    ]
    return told + [
        f"{name}: a drive of another kind (a DC motor, a muscle), whose own law these are not" for name in odd
    ]


def left_unsaid(diagnosis: Diagnosis, drives: list[DriveSettings]) -> list[str]:
    """What the terms leave out, in words."""
    told = ["velocity limits: neither the model nor short forecasts say them"]
    if any("effort_limit" not in d.values for d in drives):
        told.append("effort limits of drives that have none in the model")
    told += own_dynamics(diagnosis.sim.spec)
    for effect in diagnosis.effects:
        where = f"{effect.name} on {effect.target}"
        if isinstance(effect, ActuatorLag):
            told.append(f"{where}: a first-order filter of {effect.time_constant:.3g} s on the commands")
        elif isinstance(effect, SensorDelay):
            told.append(f"{where}: counted as a delay of the commands, which is the same to a controller")
        elif effect.name in ELSEWHERE and not isinstance(effect, Numerics):
            told.append(f"{where}: belongs to the bodies or the world, see the MJCF table")
        elif effect.name not in SAID and not isinstance(effect, Numerics):
            told.append(f"{where}: no term for it, to be done in the action or observation terms")
    return told

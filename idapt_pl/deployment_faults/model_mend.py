"""What a mend changes in the model: drives that are of another kind, and which way is down."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np

from idapt_pl.deployment_faults.mend import Drive, Mend


def mended_model(model: mujoco.MjModel, mend: Mend) -> mujoco.MjModel:
    """The nominal model with a mend's changes; the model itself where there are none."""
    changed = with_drives(model, mend.drives)
    if mend.gravity is not None:
        changed = copy(changed)
        changed.opt.gravity = mend.gravity
    return changed


def mended_spec(spec: mujoco.MjSpec, mend: Mend) -> mujoco.MjSpec:
    """The same of a model that can be edited; a copy."""
    made = spec.copy()
    for actuator, drive in zip(made.actuators, mend.drives, strict=bool(mend.drives)) if mend.drives else ():
        if drive is None:
            continue
        actuator.gear = np.eye(6)[0]
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[:3] = drive[0], 0, 0
        actuator.biasprm[:3] = 0, drive[1], drive[2]
        actuator.ctrllimited = actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if mend.gravity is not None:
        made.option.gravity = mend.gravity
    return made


def with_drives(model: mujoco.MjModel, drives: tuple[Drive | None, ...]) -> mujoco.MjModel:
    """A model whose actuators follow other laws; they act on their joints without a gear, commands without limits."""
    if not any(d is not None for d in drives):
        return model
    changed = copy(model)
    for i, drive in enumerate(drives):
        if drive is None:
            continue
        changed.actuator_gear[i] = np.eye(6)[0]
        changed.actuator_gaintype[i] = mujoco.mjtGain.mjGAIN_FIXED
        changed.actuator_biastype[i] = mujoco.mjtBias.mjBIAS_AFFINE
        changed.actuator_gainprm[i, :3] = drive[0], 0, 0
        changed.actuator_biasprm[i, :3] = 0, drive[1], drive[2]
        changed.actuator_ctrllimited[i] = changed.actuator_forcelimited[i] = 0
    return changed

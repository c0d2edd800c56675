"""Joints that a recording holds still: locked, or not recorded and set to one number by the map.

A model whose joint is free there lets it fall, and every other joint with it. So it is held by an equality constraint
while the recordings are compared with the model, which the repaired model does not keep.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from datamodules import Episode, Trajectories

PREFIX = "held in the recordings: "
STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""``solimp``: next to nothing gives way."""


def hold_still_joints(spec: mujoco.MjSpec, data: Trajectories) -> dict[str, float]:
    """Hold the hinges and slides that have one position throughout, to the last digit, and are not driven.

    A joint that is told to move and does not is a finding, and stays free. So does everything if nothing moves at all,
    or the recordings do not fit the model, as others will say.

    Args:
        spec: the model, which is edited; joints have names.
        data: recordings with ``qpos`` (T+1, nq), or a ``state`` that begins with it.

    Returns:
        Where the joints that are held are, rad or m, by their names.
    """
    model = spec.copy().compile()
    found = ((model.joint(j).name, one_position(model, j, data)) for j in range(model.njnt))
    still = {name: q for name, q in found if q is not None}
    if len(still) == model.njnt:
        return {}
    hold_joints(spec, still)
    return still


def hold_joints(spec: mujoco.MjSpec, positions: Mapping[str, float]) -> None:
    """Hold hinges and slides in a model, which is edited, at positions [rad or m].

    Raises:
        KeyError: the model has no such joint.
    """
    model = spec.copy().compile()
    for name, position in positions.items():
        from_home = position - float(model.qpos0[model.jnt_qposadr[model.joint(name).id]])
        spec.add_equality(
            name=PREFIX + name, type=mujoco.mjtEq.mjEQ_JOINT, name1=name, objtype=mujoco.mjtObj.mjOBJ_JOINT,
            data=[from_home, *[0.0] * (mujoco.mjNEQDATA - 1)], solref=[2.001 * model.opt.timestep, 1.0], solimp=STIFF,
        )  # fmt: skip


def joints_held(spec: mujoco.MjSpec) -> set[str]:
    """Names of the joints that are held in a model."""
    return {e.name.removeprefix(PREFIX) for e in spec.equalities if e.name.startswith(PREFIX)}


def one_position(model: mujoco.MjModel, joint: int, data: Trajectories) -> float | None:
    """Where a hinge or slide is in all recordings, if that is one number and no command of its own changes."""
    if mujoco.mjtJoint(model.jnt_type[joint]) not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        return None
    at = int(model.jnt_qposadr[joint])
    positions = [p[:, at] for e in data if (p := positions_of(e, model)) is not None]
    if len(positions) < len(data) or any(np.ptp(p) for p in positions) or len({float(p[0]) for p in positions}) > 1:
        return None
    motors = [k for k in range(model.nu) if drives(model, k, joint)]
    commands = [e.actions[:, k] for e in data for k in motors if k < e.actions.shape[1]]
    return None if any(len(c) and np.ptp(c) for c in commands) else float(positions[0][0])


def positions_of(episode: Episode, model: mujoco.MjModel) -> np.ndarray | None:
    """Positions (T+1, nq or more) of an episode that fits the model."""
    for name, width in ("qpos", model.nq), ("state", model.nq + model.nv):
        if name in episode.observations:
            seen = episode.observations[name]
            return seen if seen.dtype.kind in "fiu" and seen.ndim == 2 and seen.shape[1] == width else None
    return None


def drives(model: mujoco.MjModel, actuator: int, joint: int) -> bool:
    """Whether an actuator acts on a joint itself; on several, through a tendon, is not known, and counts."""
    of_joints = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    if mujoco.mjtTrn(model.actuator_trntype[actuator]) in of_joints:
        return bool(model.actuator_trnid[actuator, 0] == joint)
    return True


def release(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The model, which is edited, without what :func:`hold_still_joints` added."""
    for equality in [e for e in spec.equalities if e.name.startswith(PREFIX)]:
        spec.delete(equality)
    return spec

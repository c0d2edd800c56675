"""Which joints actuators act on: themselves, or through a tendon that is fixed to joints."""

from __future__ import annotations

import mujoco

ON_JOINT = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
"""Transmissions to a joint itself."""


def joints_of_actuators(model: mujoco.MjModel) -> set[int]:
    """Numbers of the joints that actuators act on."""
    driven = set[int]()
    for kind, (target, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if mujoco.mjtTrn(int(kind)) in ON_JOINT:
            driven.add(int(target))
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            wraps = range(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
            on_joint = [w for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT and model.wrap_prm[w]]
            driven |= {int(model.wrap_objid[w]) for w in on_joint}
    return driven


def names_of_joints_of_actuators(spec: mujoco.MjSpec) -> set[str]:
    """The same by name, of a model that is not compiled."""
    driven = {a.target for a in spec.actuators if a.trntype in ON_JOINT}
    for name in {a.target for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_TENDON}:
        for wrap in spec.tendon(name).path:
            if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT and wrap.coef:
                driven.add(wrap.target.name)
    return driven

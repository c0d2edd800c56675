"""Where a joint ends: stops that a machine has elsewhere than its model, or that the model does not have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, find_joints, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, mechanical_joints
from idapt_pl.effects.joints import per_radian

OPEN = 1e3
"""Where an end is that a joint does not have, rad or m."""
LOWER, UPPER = 0, 1
ENDS = ("lower", "upper")
"""The two ends of a range."""


@dataclass(frozen=True)
class JointRange(Effect):
    """Where a joint's end stops are; an end that is not given stays as it is in the model.

    A cable, a housing or a wrong drawing may end a motion before the model does, or after it.
    """

    name: ClassVar[str] = "joint_range"
    phrase: ClassVar[str] = "an end stop of joint"
    lower: float | None = parameter("rad or m", -OPEN, OPEN, default=None)
    upper: float | None = parameter("rad or m", -OPEN, OPEN, default=None)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for joint in find_joints(spec, self.target):
            if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                self.move_ends(spec, joint)

    def move_ends(self, spec: mujoco.MjSpec, joint: Any) -> None:
        """Set the ends of one joint.

        Raises:
            ValueError: the lower end would not be below the upper one.
        """
        unit = per_radian(spec, joint)
        lower, upper = np.asarray(joint.range) / unit if is_limited(spec, joint) else (-OPEN, OPEN)
        lower, upper = (own if end is None else end for own, end in ((lower, self.lower), (upper, self.upper)))
        if lower >= upper:
            raise ValueError(
                f"joint_range on {joint.name!r}: from {lower:g} to {upper:g} is no range: lower must be below upper"
            )
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, (lower * unit, upper * unit)

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Where the recordings show a stop that the model does not have there."""
        found = []
        for j, v, name in mechanical_joints(model):
            for k in (LOWER, UPPER):
                if name and typical.stops.size and np.isfinite(typical.stops[v, k]):
                    found.append(cls.candidate_at(model, j, k, float(typical.stops[v, k]), float(typical.range[v])))
        return found

    @classmethod
    def candidate_at(cls, model: mujoco.MjModel, j: int, k: int, seen: float, motion: float) -> Candidate:
        """One end of a joint that moved through ``motion`` and was seen to stop at ``seen``, rad or m."""
        inward, limited = (1, -1)[k], bool(model.jnt_limited[j])
        nominal = float(model.jnt_range[j, k]) if limited else seen - inward * motion
        starts = tuple((seen + inward * share * motion,) for share in (0.0, 0.01, 0.02, 0.06))
        innermost = seen + inward * 0.49 * motion  # a joint that moved further has no stop there
        other = float(model.jnt_range[j, 1 - k]) - inward * 0.01 * motion if limited else inward * OPEN
        if k == LOWER:
            span = (-OPEN, max(nominal, min(innermost, other)))
        else:
            span = (min(nominal, max(innermost, other)), OPEN)
        return Candidate(
            cls, model.joint(j).name, (ENDS[k],), (nominal,), (0.1 * motion,), starts, span=(span,),
            only_stands_for_none=not limited,
        )  # fmt: skip


def is_limited(spec: mujoco.MjSpec, joint: Any) -> bool:
    """Whether a joint has ends in a model."""
    if joint.limited != mujoco.mjtLimited.mjLIMITED_AUTO:
        return bool(joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE)
    return bool(spec.compiler.autolimits) and joint.range[0] < joint.range[1]

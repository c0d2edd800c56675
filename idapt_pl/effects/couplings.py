"""Effects on two joints at once: a motor that turns with both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import mujoco

from idapt_pl.effects.base import Effect, names_in, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, joints_with_motor

RUBS_AND_WEIGHS = ("damping", "frictionloss", "armature")
"""Parameters that say how strong it is."""

WAYS = (1.0, -1.0)
"""Usual ratios: the motor turns with the first joint as far as with the second, or against it."""

FELT_BEFORE = 0.3
"""Of the first joint's inertia, that counts at the second one at least: a last flange may weigh next to nothing."""


@dataclass(frozen=True)
class SharedMotor(Effect):
    """A motor that turns with two joints, so that its friction and its rotor are felt by both.

    So it is in wrists whose last motors sit in the forearm, in legs whose knee is driven by a belt from the hip, and in
    differentials. Sizes are as felt at the second joint, and the motor's speed is there second + ratio · first. It is
    MuJoCo's fixed tendon.
    """

    name: ClassVar[str] = "shared_motor"
    phrase: ClassVar[str] = "friction and rotor of a motor shared by joints"
    told_anyway: ClassVar[tuple[str, ...]] = ("ratio",)
    damping: float = parameter("N·m·s/rad or N·s/m", 0.0, 1e6, default=0.0)
    frictionloss: float = parameter("N·m or N", 0.0, 1e6, default=0.0)
    armature: float = parameter("kg·m² or kg", 0.0, 1e6, default=0.0)
    ratio: float = parameter("1", -1e3, 1e3, default=1.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        known = [j.name for j in spec.joints]
        names = names_in(self.target, known)
        if len(names) != 2:
            raise ValueError(
                f"{self.name} needs two joints, with a space between, got {self.target!r}; the model has {known}"
            )
        tendon = spec.add_tendon()
        tendon.wrap_joint(names[0], self.ratio)
        tendon.wrap_joint(names[1], 1.0)
        tendon.damping[0], tendon.frictionloss, tendon.armature = self.damping, self.frictionloss, self.armature

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Of a driven joint and the next one after it, both hinges or both slides: one to one, either way, and freely.

        A fit of the ratio goes astray where single friction of the joints stands in for much of it already.
        """
        found = []
        for (first, u), (second, v) in driven_neighbours(model):
            inertia = max(typical.inertia[v], FELT_BEFORE * typical.inertia[u])
            sizes = (inertia / typical.horizon, inertia * typical.speed[v] / typical.horizon, inertia)
            rubbing = [(0.0, f * sizes[1], 0.0) for f in (1.0, 10.0)]
            one = Candidate(cls, f"{first} {second}", RUBS_AND_WEIGHS, (0.0, 0.0, 0.0), sizes, tuple(rubbing))
            found += [replace(one, fixed=(("ratio", way),)) for way in WAYS]
            found.append(
                replace(
                    one,
                    names=(*RUBS_AND_WEIGHS, "ratio"),
                    nominal=(*one.nominal, WAYS[0]),
                    scale=(*sizes, 0.3),
                    starts=tuple((*x, way) for x in rubbing for way in WAYS),
                    strength=len(RUBS_AND_WEIGHS),
                )
            )
        return found


def driven_neighbours(model: mujoco.MjModel) -> list[tuple[tuple[str, int], tuple[str, int]]]:
    """Names and degrees of freedom of two driven joints of a kind, one next after the other."""
    driven = {v: (j, name) for j, v, name in joints_with_motor(model) if name}
    found = []
    for v, (j, name) in driven.items():
        before = int(model.dof_parentid[v])
        if before in driven and model.jnt_type[driven[before][0]] == model.jnt_type[j]:
            found.append(((driven[before][1], before), (name, v)))
    return found

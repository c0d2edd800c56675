"""Effects on contacts: friction and softness of geoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from idapt_pl.effects.base import Effect, elements, parameter


@dataclass(frozen=True)
class ContactFriction(Effect):
    """Sliding friction coefficient of a geom."""

    name: ClassVar[str] = "contact_friction"
    sliding: float = parameter("1", 0.0, 1e2)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in elements(spec, "geoms", self.target):
            geom.friction[0] = self.sliding


@dataclass(frozen=True)
class ContactSoftness(Effect):
    """Time constant of contacts (``solref[0]``): the larger, the softer."""

    name: ClassVar[str] = "contact_softness"
    time_constant: float = parameter("s", 1e-4, 1e1)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in elements(spec, "geoms", self.target):
            geom.solref[0] = self.time_constant

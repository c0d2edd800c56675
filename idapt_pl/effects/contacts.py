"""Effects on contacts: friction and softness of geoms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco

from idapt_pl.effects.base import Effect, find_elements, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes


def touching_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something; none where there is nothing for one to touch."""
    able = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    return able if len(able) > 1 else []


@dataclass(frozen=True)
class ContactFriction(Effect):
    """Sliding friction coefficient of a geom."""

    name: ClassVar[str] = "contact_friction"
    phrase: ClassVar[str] = "contact friction of geom"
    sliding: float = parameter("1", 0.0, 1e2)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in find_elements(spec, "geoms", self.target):
            geom.friction[0] = self.sliding

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        friction = {g: float(model.geom_friction[g, 0]) for g in touching_geoms(model)}
        if not friction:
            return []
        largest = max(friction.values())

        def one(target: str, own: float, *starts: float) -> Candidate:
            return Candidate(cls, target, ("sliding",), (own,), (0.3 * own + 0.05,), tuple((s,) for s in starts))

        found = [one("*", largest, 0.3 * largest, 0.6 * largest, 1.7 * largest)]
        for g, own in friction.items():
            # of two geoms the larger friction counts: less of one alone shows only where it had more than the other
            starts = (0.4 * own, 2.0 * own) if own == largest else (2.0 * largest,)
            found += [one(model.geom(g).name, own, *starts)] if model.geom(g).name else []
        return found


@dataclass(frozen=True)
class ContactSoftness(Effect):
    """Time constant of contacts (``solref[0]``): the larger, the softer."""

    name: ClassVar[str] = "contact_softness"
    phrase: ClassVar[str] = "contact softness of geom"
    time_constant: float = parameter("s", 1e-4, 1e1)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in find_elements(spec, "geoms", self.target):
            geom.solref[0] = self.time_constant

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        able = touching_geoms(model)
        soft = float(model.geom_solref[able[0], 0]) if able else 0.0
        if soft <= 0:  # MuJoCo's direct form, stiffness and damping, has no time constant
            return []
        return [Candidate(cls, "*", ("time_constant",), (soft,), (0.5 * soft,), ((0.5 * soft,), (2.5 * soft,)))]

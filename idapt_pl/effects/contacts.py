"""Effects on contacts: friction and softness of geoms, or of a pair of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, find_elements, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes

SLIDING, TORSIONAL, ROLLING = 0, 1, 2
"""Where a geom has its coefficients of friction; a pair of geoms has the first and the last of them twice."""
OF_PAIRS = {SLIDING: (0, 1), TORSIONAL: (2,), ROLLING: (3, 4)}
FEW_GEOMS = 4
"""Up to so many geoms that can touch something, each is tried on its own with all that a contact has."""


def touching_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something; none where there is nothing for one to touch."""
    able = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    return able if len(able) > 1 else []


def named_pairs(model: mujoco.MjModel) -> list[tuple[int, str]]:
    """Number and target, the names of two geoms, of the pairs that a model lists (``<contact><pair>``)."""
    geoms = zip(model.pair_geom1, model.pair_geom2, strict=True)
    names = [tuple(model.geom(int(g)).name for g in pair) for pair in geoms]
    return [(i, " ".join(two)) for i, two in enumerate(names) if all(two)]


def touching(spec: mujoco.MjSpec, target: str) -> tuple[list[Any], list[Any]]:
    """Geoms and listed pairs that a target means: a geom, ``"*"``, or two geoms that touch each other.

    Two geoms that the model does not list as a pair are listed, with what their contact has anyway.

    Raises:
        ValueError: there is no such geom.
    """
    names = target.split()
    if target == "*":
        return find_elements(spec, "geoms", target), list(spec.pairs)
    if len(names) != 2 or target in {g.name for g in spec.geoms}:
        return find_elements(spec, "geoms", target), []
    listed = [p for p in spec.pairs if {p.geomname1, p.geomname2} == set(names)]
    if listed:
        return [], listed
    one, other = (find_elements(spec, "geoms", name)[0] for name in names)
    friction = np.maximum(one.friction, other.friction)
    pair = spec.add_pair(geomname1=one.name, geomname2=other.name, condim=max(one.condim, other.condim))
    pair.friction = friction[[SLIDING, SLIDING, TORSIONAL, ROLLING, ROLLING]]
    pair.solref = (np.asarray(one.solref) + other.solref) / 2
    pair.solimp = (np.asarray(one.solimp) + other.solimp) / 2
    return [], [pair]


@dataclass(frozen=True)
class ContactFriction(Effect):
    """Friction coefficients of a geom, or of two that touch each other (``"foot floor"``).

    Of two geoms the larger one counts. ``torsional`` is against spinning about the contact's normal, ``rolling``
    against rolling; both are lengths, and both count only where the contact has dimensions for them (``condim`` 4, 6).
    """

    name: ClassVar[str] = "contact_friction"
    phrase: ClassVar[str] = "contact friction of geom"
    sliding: float | None = parameter("1", 0.0, 1e2, default=None)
    torsional: float | None = parameter("m", 0.0, 1e2, default=None)
    rolling: float | None = parameter("m", 0.0, 1e2, default=None)

    def apply(self, spec: mujoco.MjSpec) -> None:
        geoms, pairs = touching(spec, self.target)
        for k, value in enumerate((self.sliding, self.torsional, self.rolling)):
            if value is None:
                continue
            for geom in geoms:
                geom.friction[k] = value
            for pair in pairs:
                for i in OF_PAIRS[k]:
                    pair.friction[i] = value

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        able = touching_geoms(model)
        dimensions = max([*model.geom_condim[able], *model.pair_dim], default=0)
        found = cls.of_kind("sliding", SLIDING, model, able)
        found += cls.of_kind("torsional", TORSIONAL, model, able) if dimensions >= 4 else []
        return found + (cls.of_kind("rolling", ROLLING, model, able) if dimensions >= 6 else [])

    @classmethod
    def of_kind(cls, name: str, k: int, model: mujoco.MjModel, able: Sequence[int]) -> list[Candidate]:
        """Candidates for one of the coefficients: all geoms at once, each geom, each listed pair."""
        friction = {g: float(model.geom_friction[g, k]) for g in able}
        pairs = {target: float(model.pair_friction[i, OF_PAIRS[k][0]]) for i, target in named_pairs(model)}
        if not friction and not pairs:
            return []
        largest = max([*friction.values(), *pairs.values()])
        least = 0.05 if k == SLIDING else 2e-4

        def one(target: str, own: float, *starts: float) -> Candidate:
            return Candidate(cls, target, (name,), (own,), (0.3 * own + least,), tuple((s,) for s in starts))

        further = (0.3 * largest, 0.6 * largest, 1.7 * largest) if k == SLIDING else (10 * largest + 10 * least,)
        found = [one("*", largest, *further)]
        for g, own in friction.items() if k == SLIDING else ():
            # of two geoms the larger friction counts: less of one alone shows only where it had more than the other
            starts = (0.4 * own, 2.0 * own) if own == largest else (2.0 * largest,)
            found += [one(model.geom(g).name, own, *starts)] if model.geom(g).name else []
        return found + [one(target, own, 0.4 * own, 2.0 * own) for target, own in pairs.items()]


def time_and_damping(solref: np.ndarray) -> tuple[float, float]:
    """A contact's time constant [s] and damping ratio [1], also where stiffness and damping are given instead."""
    if solref[0] > 0:
        return float(solref[0]), float(solref[1])
    stiffness, damping = -float(solref[0]), -float(solref[1])
    return 2 / max(damping, 1e-9), damping / (2 * np.sqrt(max(stiffness, 1e-9)))


@dataclass(frozen=True)
class ContactSoftness(Effect):
    """How contacts give way (``solref``), of a geom or of two that touch each other (``"ball floor"``).

    The larger the time constant, the softer; below a damping ratio of 1 things bounce. MuJoCo takes the mean of two
    geoms.
    """

    name: ClassVar[str] = "contact_softness"
    phrase: ClassVar[str] = "contact softness of geom"
    time_constant: float | None = parameter("s", 1e-4, 1e1, default=None)
    damping_ratio: float | None = parameter("1", 1e-3, 1e1, default=None)

    def apply(self, spec: mujoco.MjSpec) -> None:
        geoms, pairs = touching(spec, self.target)
        for element in (*geoms, *pairs):
            time, damping = time_and_damping(np.asarray(element.solref))
            new = self.time_constant or time, self.damping_ratio or damping
            element.solref[0], element.solref[1] = new

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """Softness, bounce, and both at once: of all contacts; of each geom and listed pair where they are few."""
        able = touching_geoms(model)
        targets = {model.geom(g).name: model.geom_solref[g] for g in able if model.geom(g).name}
        targets = targets if 2 < len(able) <= FEW_GEOMS else {}
        targets |= {target: model.pair_solref[i] for i, target in named_pairs(model)}
        if not able and not targets:
            return []
        of_all = cls.one("*", *time_and_damping(model.geom_solref[able[0]] if able else model.pair_solref[0]))
        return of_all + [cls.one(target, *time_and_damping(solref))[-1] for target, solref in targets.items()]

    @classmethod
    def one(cls, target: str, time: float, damping: float) -> list[Candidate]:
        """The three candidates for one target."""
        both = Candidate(
            cls,
            target,
            ("time_constant", "damping_ratio"),
            (time, damping),
            (0.5 * time, 0.3 * damping),
            tuple((t * time, r * damping) for t in (0.5, 2.0) for r in (0.1, 0.3)),
        )
        of_time = ((0.5 * time,), (2.5 * time,))
        of_damping = tuple((r * damping,) for r in (0.05, 0.15, 0.3, 0.6, 2.0))
        return [
            replace(both, names=("time_constant",), nominal=(time,), scale=(0.5 * time,), starts=of_time),
            replace(both, names=("damping_ratio",), nominal=(damping,), scale=(0.3 * damping,), starts=of_damping),
            both,
        ]

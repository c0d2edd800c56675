"""Effects on bodies: mass, inertia, centre of mass, payload."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.linalg import expm

from idapt_pl.effects.base import Effect, find_elements, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, moved_bodies, scaled_starts

LIGHTEST = 1e-6
"""A body of this mass, kg, or less is a marker and no part of a machine."""


def heavy_bodies(model: mujoco.MjModel) -> list[tuple[str, float, float]]:
    """Moving bodies with a mass: name, mass in kg, and how far a noticeable shift of the centre is, in m."""
    found = []
    for b, name in moved_bodies(model):
        if (mass := float(model.body_mass[b])) > LIGHTEST:
            found.append((name, mass, 0.3 * float(np.sqrt(model.body_inertia[b].max() / mass)) + 1e-3))
    return found


def compiled_bodies(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a spec with all its bodies, in the spec's order, also those that are fused with parents."""
    twin = spec.copy()
    twin.compiler.fusestatic = False
    return twin.compile()


@dataclass(frozen=True)
class BodyMass(Effect):
    """Mass of a body. Its inertia scales along: the shape and density profile stay the same."""

    name: ClassVar[str] = "body_mass"
    phrase: ClassVar[str] = "mass of body"
    mass: float = parameter("kg", LIGHTEST, 1e6)

    def apply(self, spec: mujoco.MjSpec) -> None:
        find_elements(spec, "bodies", self.target)  # raises if there is none
        masses = compiled_bodies(spec).body_mass.tolist()
        for body, now in zip(spec.bodies, masses, strict=True):
            if self.target not in ("*", body.name):
                continue
            if now == 0.0:
                if self.target == "*":
                    continue
                raise ValueError(f"body_mass: body {body.name!r} has no mass to scale")
            ratio = self.mass / now
            if body.explicitinertial:
                body.mass *= ratio
                body.inertia = np.asarray(body.inertia) * ratio
                body.fullinertia = np.asarray(body.fullinertia) * ratio
            for geom in body.geoms:
                geom.density *= ratio
                geom.mass *= ratio  # NaN (mass from density) stays NaN

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return [Candidate(cls, name, ("mass",), (m,), (m,), scaled_starts(m)) for name, m, _ in heavy_bodies(model)]


def explicit_inertial(spec: mujoco.MjSpec, target: str) -> list[Any]:
    """Bodies with their mass, centre and inertia written out, as MuJoCo computes them from the geoms."""
    bodies = find_elements(spec, "bodies", target)
    model = compiled_bodies(spec)
    for body in bodies:
        compiled = model.body(body.name) if body.name else model.body(body.id)
        if not body.explicitinertial or not np.isnan(body.fullinertia[0]):
            body.explicitinertial = True
            body.mass = float(compiled.mass[0])
            body.ipos, body.iquat, body.inertia = compiled.ipos, compiled.iquat, compiled.inertia
            body.fullinertia = [np.nan, 0, 0, 0, 0, 0]  # not given
    return bodies


@dataclass(frozen=True)
class BodyCom(Effect):
    """Centre of mass of a body, moved from where the model has it, in the body's frame."""

    name: ClassVar[str] = "body_com"
    phrase: ClassVar[str] = "centre of mass of body"
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in explicit_inertial(spec, self.target):
            body.ipos = np.add(body.ipos, (self.x, self.y, self.z))

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        return [
            Candidate(cls, name, ("x", "y", "z"), (0.0,) * 3, (reach,) * 3) for name, _, reach in heavy_bodies(model)
        ]


@dataclass(frozen=True)
class BodyInertia(Effect):
    """Mass, centre and rotational inertia of a body at once, relative to what the model has: ten numbers.

    The inertia about the centre, in the body's principal axes, becomes √I exp(E) √I with E symmetric, so that it stays
    positive; MuJoCo balances one that no body could have. ``rotation`` scales it as a whole.
    """

    name: ClassVar[str] = "body_inertia"
    phrase: ClassVar[str] = "mass, centre and inertia of body"
    mass: float = parameter("1", 1e-3, 1e3, default=1.0)
    rotation: float = parameter("1", 1e-3, 1e3, default=1.0)
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)
    xx: float = parameter("1", -5.0, 5.0, default=0.0)
    yy: float = parameter("1", -5.0, 5.0, default=0.0)
    xy: float = parameter("1", -5.0, 5.0, default=0.0)
    xz: float = parameter("1", -5.0, 5.0, default=0.0)
    yz: float = parameter("1", -5.0, 5.0, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in explicit_inertial(spec, self.target):
            body.mass *= self.mass
            body.ipos = np.add(body.ipos, (self.x, self.y, self.z))
            body.inertia = np.asarray(body.inertia) * self.rotation
            if any((self.xx, self.yy, self.xy, self.xz, self.yz)):
                self.deform(body)
                spec.compiler.balanceinertia = True

    def deform(self, body: Any) -> None:
        """Apply exp(E); the trace of E is zero, as ``rotation`` is there for the rest."""
        E = np.array([[self.xx, self.xy, self.xz], [self.xy, self.yy, self.yz], [self.xz, self.yz, -self.xx - self.yy]])
        root = np.diag(np.sqrt(np.asarray(body.inertia)))
        principal, axes = np.linalg.eigh(root @ expm(E) @ root)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        turn, whole = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(turn, axes.ravel())
        mujoco.mju_mulQuat(whole, np.asarray(body.iquat, float), turn)
        body.inertia, body.iquat = principal, whole

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        names = ("mass", "rotation", "x", "y", "z", "xx", "yy", "xy", "xz", "yz")
        nominal = (1.0, 1.0, *(0.0,) * 8)
        return [
            Candidate(cls, name, names, nominal, (0.5, 0.5, *(reach,) * 3, *(0.5,) * 5))
            for name, _, reach in heavy_bodies(model)
        ]


@dataclass(frozen=True)
class Payload(Effect):
    """A point mass fixed to a body, at a place in the body's frame."""

    name: ClassVar[str] = "payload"
    phrase: ClassVar[str] = "a load on body"
    mass: float = parameter("kg", 0.0, 1e5)
    x: float = parameter("m", -1e2, 1e2, default=0.0)
    y: float = parameter("m", -1e2, 1e2, default=0.0)
    z: float = parameter("m", -1e2, 1e2, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for body in find_elements(spec, "bodies", self.target):
            if self.mass:
                load = body.add_body(pos=(self.x, self.y, self.z))
                load.explicitinertial, load.mass, load.inertia = True, self.mass, [1e-9 * self.mass] * 3
                load.ipos = np.zeros(3)  # without a place, `to_xml` writes no mass

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        names, found = ("mass", "x", "y", "z"), []
        for name, mass, reach in heavy_bodies(model):
            scale, share = (mass, *(3 * reach,) * 3), 0.2 * mass
            starts = ((share, 0.0, 0.0, 0.0), (share, 3 * reach, 0.0, 3 * reach))
            found.append(Candidate(cls, name, names, (0.0,) * 4, scale, starts, strength=1))
        return found

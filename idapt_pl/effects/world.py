"""Effects on the world: gravity, the medium, external forces, numerics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, parameter
from idapt_pl.effects.candidate import Candidate, TypicalSizes, moved_bodies
from idapt_pl.effects.runtime import ForceEffect


@dataclass(frozen=True)
class GravityDirection(Effect):
    """Gravity turned away from straight down: the base stands on a slope. Target is ``"world"``."""

    name: ClassVar[str] = "gravity_direction"
    phrase: ClassVar[str] = "direction of gravity"
    tilt_x: float = parameter("rad", -np.pi, np.pi)
    tilt_y: float = parameter("rad", -np.pi, np.pi)

    def apply(self, spec: mujoco.MjSpec) -> None:
        g = np.linalg.norm(spec.option.gravity)
        sx, cx, sy, cy = np.sin(self.tilt_x), np.cos(self.tilt_x), np.sin(self.tilt_y), np.cos(self.tilt_y)
        spec.option.gravity = g * np.array([-sy * cx, sx, -cx * cy])

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        strength = np.linalg.norm(model.opt.gravity)
        if not strength > 0 or abs(model.opt.gravity[2]) <= 0.99 * strength:
            return []
        alone = (("tilt_x", "tilt_y"), ("tilt_y", "tilt_x"))  # a planar machine feels one of them alone
        found = [Candidate(cls, "world", (one,), (0.0,), (0.1,), fixed=((other, 0.0),)) for one, other in alone]
        return [*found, Candidate(cls, "world", ("tilt_x", "tilt_y"), (0.0, 0.0), (0.1, 0.1))]


@dataclass(frozen=True)
class Numerics(Effect):
    """Time step and integrator of the simulation itself. Target is ``"world"``.

    No candidate: an integrator is no number to fit. A diagnosis tries a few of them before and between the effects.
    """

    name: ClassVar[str] = "numerics"
    phrase: ClassVar[str] = "time step and integrator of the simulation"
    searched: ClassVar[bool] = False
    timestep: float = parameter("s", 1e-6, 1.0)
    integrator: str = "Euler"

    def apply(self, spec: mujoco.MjSpec) -> None:
        kinds = {k: f"mjINT_{k.upper()}" for k in ("Euler", "RK4", "implicit", "implicitfast")}
        if self.integrator not in kinds:
            raise ValueError(f"numerics: integrator must be one of {', '.join(kinds)}, got {self.integrator!r}")
        spec.option.timestep = self.timestep
        spec.option.integrator = getattr(mujoco.mjtIntegrator, kinds[self.integrator])


@dataclass(frozen=True)
class FluidDrag(Effect):
    """The medium everything moves through (MuJoCo's inertia-box model). Target is ``"world"``."""

    name: ClassVar[str] = "fluid_drag"
    phrase: ClassVar[str] = "drag of the surrounding medium"
    density: float = parameter("kg/m³", 0.0, 1e5, default=0.0)
    viscosity: float = parameter("Pa·s", 0.0, 1e5, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        spec.option.density, spec.option.viscosity = self.density, self.viscosity

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        density, viscosity = float(model.opt.density), float(model.opt.viscosity)
        noticeable = 100.0 if density else 5.0  # of a liquid; of air
        return [
            Candidate(cls, "world", ("density",), (density,), (noticeable,), fixed=(("viscosity", viscosity),)),
            Candidate(cls, "world", ("viscosity",), (viscosity,), (1.0,), fixed=(("density", density),)),
        ]


@dataclass(frozen=True)
class ExternalForce(ForceEffect):
    """A constant force on a body at its centre of mass, in the world's axes."""

    name: ClassVar[str] = "external_force"
    phrase: ClassVar[str] = "a constant force on body"
    acts_on: ClassVar[str] = "bodies"
    x: float = parameter("N", -1e6, 1e6, default=0.0)
    y: float = parameter("N", -1e6, 1e6, default=0.0)
    z: float = parameter("N", -1e6, 1e6, default=0.0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.broadcast_to((self.x, self.y, self.z), (len(time), 3))

    @classmethod
    def candidates(cls, model: mujoco.MjModel, typical: TypicalSizes) -> list[Candidate]:
        """On the root of each mechanism, which may stand on a base that is welded to the world."""
        usual = float(np.median(typical.inertia)) * float(np.median(typical.speed)) / typical.horizon
        scale = (usual + 0.05 * float(model.body_mass.sum()),) * 3
        roots = [name for b, name in moved_bodies(model) if model.body_weldid[model.body_parentid[b]] == 0]
        return [Candidate(cls, name, ("x", "y", "z"), (0.0,) * 3, scale) for name in roots]

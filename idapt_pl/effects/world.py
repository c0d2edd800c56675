"""Effects on the world: gravity, the medium, external forces, numerics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, parameter
from idapt_pl.effects.runtime import ForceEffect


@dataclass(frozen=True)
class GravityDirection(Effect):
    """Gravity turned away from straight down: the base stands on a slope. Target is ``"world"``."""

    name: ClassVar[str] = "gravity_direction"
    tilt_x: float = parameter("rad", -np.pi, np.pi)
    tilt_y: float = parameter("rad", -np.pi, np.pi)

    def apply(self, spec: mujoco.MjSpec) -> None:
        g = np.linalg.norm(spec.option.gravity)
        sx, cx, sy, cy = np.sin(self.tilt_x), np.cos(self.tilt_x), np.sin(self.tilt_y), np.cos(self.tilt_y)
        spec.option.gravity = g * np.array([-sy * cx, sx, -cx * cy])


@dataclass(frozen=True)
class Numerics(Effect):
    """Time step and integrator of the simulation itself. Target is ``"world"``."""

    name: ClassVar[str] = "numerics"
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
    density: float = parameter("kg/m³", 0.0, 1e5, default=0.0)
    viscosity: float = parameter("Pa·s", 0.0, 1e5, default=0.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        spec.option.density, spec.option.viscosity = self.density, self.viscosity


@dataclass(frozen=True)
class ExternalForce(ForceEffect):
    """A constant force on a body at its centre of mass, in the world's axes."""

    name: ClassVar[str] = "external_force"
    kind: ClassVar[str] = "bodies"
    x: float = parameter("N", -1e6, 1e6, default=0.0)
    y: float = parameter("N", -1e6, 1e6, default=0.0)
    z: float = parameter("N", -1e6, 1e6, default=0.0)

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.broadcast_to((self.x, self.y, self.z), (len(time), 3))

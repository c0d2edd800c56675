"""A domain is an MJCF model plus a list of effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.domains.effects import Effect


@dataclass(frozen=True)
class Domain:
    """One world: a base model and what is different about it.

    Attributes:
        name: for example ``"source"``, ``"easy"``, ``"hard"``.
        base: builds a fresh base ``MjSpec``.
        effects: edits applied in order.
    """

    name: str
    base: Callable[[], mujoco.MjSpec]
    effects: tuple[Effect, ...] = ()

    def with_effects(self, *effects: Effect) -> Domain:
        """The same domain with more effects."""
        return Domain(self.name, self.base, (*self.effects, *effects))

    def spec(self) -> mujoco.MjSpec:
        """The base model with all effects applied."""
        spec = self.base()
        for effect in self.effects:
            effect.apply(spec)
        return spec

    def compile(self, view: float = 1.0) -> mujoco.MjModel:
        """The compiled model, with rendering sized for small images.

        MuJoCo sizes its shadow map for a screen; at 64 to 100 pixels it costs up to 100x the frame and
        changes little, so it is off in every domain. Multisampling stays: without it, edges move in
        steps of a pixel, and the speed of a pole cannot be read from three small frames.

        Args:
            view: share of the camera's field of view that is imaged, around its middle.
        """
        spec = self.spec()
        for camera in spec.cameras:
            camera.fovy = np.rad2deg(2 * np.arctan(view * np.tan(np.deg2rad(camera.fovy) / 2)))
        spec.visual.quality.shadowsize = 0
        spec.visual.quality.offsamples = 4
        return spec.compile()

"""A domain is an MJCF model plus a list of effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

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

    def compile(self) -> mujoco.MjModel:
        """The compiled model, with rendering sized for small images.

        MuJoCo sizes its shadow map and multisampling for a screen; at 64 to 100 pixels they cost up to
        100x the frame and change little, so both are off in every domain.
        """
        spec = self.spec()
        spec.visual.quality.shadowsize = 0
        spec.visual.quality.offsamples = 0
        return spec.compile()

"""A domain is an MJCF model plus a list of effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.acting import register_laws
from idapt_pl.effects.base import Effect
from idapt_pl.effects.compile_time import write_out_masses
from idapt_pl.effects.runtime import CommandEffect, ForceEffect
from idapt_pl.ranges import Range, check_ranges


@dataclass(frozen=True)
class View:
    """Which part of the camera's image is rendered: a square window, at full resolution.

    Args:
        share: side of the window, as a share of the whole image's.
        up: how far the window's middle lies above the image's, in the same measure.
        right: how far it lies to the right of it.
    """

    share: float = 1.0
    up: float = 0.0
    right: float = 0.0

    def __post_init__(self) -> None:
        check_ranges("view", vars(self), {"share": Range(0, 1, "(]"), "up": Range(-1, 1), "right": Range(-1, 1)})

    def apply(self, spec: mujoco.MjSpec) -> None:
        """Narrow every camera to the window. Lengths are in units of the whole image."""
        for camera in spec.cameras:
            focal = 0.5 / np.tan(np.deg2rad(camera.fovy) / 2)
            camera.focal_length, camera.sensor_size = [focal] * 2, [self.share] * 2
            camera.principal_length = [self.right, -self.up]


WHOLE = View()
"""The camera's whole image."""


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

    def named(self, name: str) -> Domain:
        """The same domain by another name."""
        return Domain(name, self.base, self.effects)

    def spec(self) -> mujoco.MjSpec:
        """The base model with all effects applied."""
        spec = self.base()
        if self.effects:
            write_out_masses(spec)
        for effect in self.effects:
            effect.apply(spec)
            if isinstance(effect, ForceEffect):
                effect.constrain(spec)
        return spec

    @property
    def beyond_mjcf(self) -> tuple[Effect, ...]:
        """Effects that :meth:`spec` does not hold, or not whole: MJCF has no words for them."""
        return tuple(
            e for e in self.effects
            if isinstance(e, ForceEffect) or (isinstance(e, CommandEffect) and not e.in_mjcf)
        )  # fmt: skip

    @property
    def within_mjcf(self) -> Domain:
        """The same domain without these."""
        beyond = self.beyond_mjcf
        return Domain(self.name, self.base, tuple(e for e in self.effects if e not in beyond))

    def command(self, model: mujoco.MjModel, actions: np.ndarray) -> np.ndarray:
        """What effects that MJCF has no words for make of actions (n, nu), in their order."""
        for effect in self.effects:
            if isinstance(effect, CommandEffect) and not effect.in_mjcf:
                columns = effect.columns(model)
                actions = actions.copy()
                actions[:, columns] = effect.law(actions[:, columns])
        return actions

    def compile(self, view: View = WHOLE) -> mujoco.MjModel:
        """The compiled model, with rendering sized for small images.

        MuJoCo sizes its shadow map for a screen; at 64 to 100 pixels it costs up to 100x the frame and
        changes little, so it is off in every domain. Multisampling stays: without it, edges move in
        steps of a pixel, and the speed of a pole cannot be read from three small frames. Round shapes have half as
        many faces each way as on a screen: most of a small frame's time is spent on their corners.

        Args:
            view: the part of the camera's image that is wanted.
        """
        spec = self.spec()
        if view != WHOLE:
            view.apply(spec)
        spec.visual.quality.shadowsize = 0
        spec.visual.quality.offsamples = 4
        spec.visual.quality.numslices = min(16, spec.visual.quality.numslices)
        spec.visual.quality.numstacks = min(8, spec.visual.quality.numstacks)
        model = spec.compile()
        register_laws(model, self.effects)
        return model

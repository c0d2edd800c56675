"""The renderer that a model asks for."""

from __future__ import annotations

import functools
import logging
import os
from typing import TypeAlias

import mujoco

from idapt_pl.effects.visual import blur_of, engine_of
from idapt_pl.rendering import filament
from idapt_pl.rendering.classic import BlurredRenderer, FrameRenderer

log = logging.getLogger(__name__)
AnyRenderer: TypeAlias = FrameRenderer | filament.FilamentRenderer | BlurredRenderer


def make_renderer(model: mujoco.MjModel, size: int) -> AnyRenderer:
    """The renderer that a model asks for, or the classic one where there is no Vulkan for Filament.

    ``IDAPT_RENDERER=classic`` in the environment asks for the classic one everywhere: it is many times faster.

    Args:
        model: compiled model with the task's camera.
        size: height and width of a frame, pixels.

    Raises:
        RenderingUnavailable: if the machine has no working GL backend.
    """
    sharp, sigma = _sharp_renderer(model, size), blur_of(model)
    return BlurredRenderer(sharp, sigma) if sigma > 0 else sharp


def _sharp_renderer(model: mujoco.MjModel, size: int) -> FrameRenderer | filament.FilamentRenderer:
    if engine_of(model) == "filament":
        if filament_is_used():
            return filament.FilamentRenderer(model, size)
        why = "IDAPT_RENDERER=classic" if classic_is_asked_for() else filament.why_unavailable()
        _warn_once(f"{why}: the classic renderer draws what Filament should. {filament.CURE}")
    return FrameRenderer(model, size)


def filament_is_used() -> bool:
    """Whether models that ask for Filament get it on this machine."""
    return not classic_is_asked_for() and filament.why_unavailable() is None


def classic_is_asked_for() -> bool:
    """Whether the user wants the classic renderer everywhere."""
    return os.environ.get("IDAPT_RENDERER") == "classic"


@functools.cache
def _warn_once(message: str) -> None:
    log.warning(message)

"""Frames of simulations of several models: each has a renderer, made when it is first seen."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.rendering.parallel import ParallelRenderer


class RendererOfSeveral:
    """Renders the frames of simulations that are in one of several models, here. A renderer takes 10 to 60 MB.

    Args:
        models: compiled models with the task's camera.
        size: height and width in pixels.
    """

    def __init__(self, models: Sequence[mujoco.MjModel], size: int) -> None:
        self._models, self._size = {id(model): model for model in models}, size
        self._renderers: dict[int, ParallelRenderer] = {}

    def __call__(self, data: Sequence[mujoco.MjData]) -> np.ndarray:
        """Render. Returns uint8 (n, size, size, 3)."""
        frames = [self._renderer(d)([d])[0] for d in data]
        return np.asarray(frames, np.uint8).reshape(len(data), self._size, self._size, 3)

    def _renderer(self, data: mujoco.MjData) -> ParallelRenderer:
        key = id(data.model)
        if key not in self._renderers:
            self._renderers[key] = ParallelRenderer(self._models[key], self._size)
        return self._renderers[key]

    def close(self) -> None:
        """Free what it renders with."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()

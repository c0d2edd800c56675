"""Small images of a model, fast, without a screen."""

from __future__ import annotations

import atexit
import os
import weakref
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.visual import CAMERA, blurred
from idapt_pl.rendering import filament


class RenderingUnavailable(RuntimeError):
    """No OpenGL context could be made; the message says what to install."""


class BlurredRenderer:
    """Renders with another renderer and blurs what it gives."""

    def __init__(self, sharp: FrameRenderer | filament.FilamentRenderer, sigma: float) -> None:
        self.size, self._sharp, self._sigma = sharp.size, sharp, sigma

    def __call__(self, data: mujoco.MjData, out: np.ndarray | None = None) -> np.ndarray:
        """Render ``data``. Returns uint8 (size, size, 3), written into ``out`` if given."""
        soft = np.rint(blurred(self._sharp(data).astype(np.float32), self._sigma)).astype(np.uint8)
        if out is None:
            return soft
        out[:] = soft
        return out

    def close(self) -> None:
        """Close the other renderer."""
        self._sharp.close()


class FrameRenderer:
    """Renders RGB frames of one model, seen by the task's camera.

    Args:
        model: compiled model with a camera named ``"view"``.
        size: height and width in pixels.

    Raises:
        RenderingUnavailable: if the machine has no working GL backend.
    """

    _alive: ClassVar[weakref.WeakSet[FrameRenderer]] = weakref.WeakSet()

    def __init__(self, model: mujoco.MjModel, size: int) -> None:
        self.size = size
        self._renderer: mujoco.Renderer | None = None
        try:
            self._renderer = mujoco.Renderer(model, height=size, width=size)
        except Exception as error:  # PyOpenGL raises AttributeError, mujoco FatalError, and others
            backend = os.environ.get("MUJOCO_GL", "")
            raise RenderingUnavailable(
                f"cannot render with MUJOCO_GL={backend} ({type(error).__name__}: {error}). Install a GL "
                "library (Debian/Ubuntu: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libosmesa6) "
                "or try MUJOCO_GL=osmesa; `idapt doctor` tests both."
            ) from None
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        if not FrameRenderer._alive:  # after the first context: exit handlers run last in, first out
            atexit.register(FrameRenderer._close_all)
        FrameRenderer._alive.add(self)

    def __call__(self, data: mujoco.MjData, out: np.ndarray | None = None) -> np.ndarray:
        """Render ``data``. Returns uint8 (size, size, 3), written into ``out`` if given."""
        self._open.update_scene(data, camera=CAMERA)
        return self._open.render(out=out)

    def upload(self, texture: int) -> None:
        """Take a texture of the model, by its number, anew, after its pixels were edited."""
        self._open._gl_context.make_current()
        mujoco.mjr_uploadTexture(self._open._model, self._open._mjr_context, texture)

    @property
    def _open(self) -> mujoco.Renderer:
        if self._renderer is None:
            raise RuntimeError("this renderer was closed; make another one")
        return self._renderer

    def close(self) -> None:
        """Free the GL context. Without the switch to it, another renderer's textures would be freed."""
        if self._renderer is not None:
            self._renderer._gl_context.make_current()
            self._renderer.close()
            self._renderer = None

    __del__ = close

    @classmethod
    def _close_all(cls) -> None:
        for renderer in list(cls._alive):
            renderer.close()

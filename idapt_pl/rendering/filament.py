"""Images by Filament, the physically based renderer in MuJoCo's wheel: another engine than the classic one."""

from __future__ import annotations

import atexit
import contextlib
import copy
import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.visual import CAMERA
from idapt_pl.rendering import vulkan

CURE = (
    "Filament, MuJoCo's physically based renderer, needs Vulkan, for which software will do "
    "(Debian/Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers)"
)


@functools.cache
def why_unavailable() -> str | None:
    """None if there is a Vulkan device, else what is missing. Asked first, since Filament ends the process without.

    A process of its own asks: a driver may crash, or make no OpenGL context where Vulkan was used before.
    """
    command = [sys.executable, "-I", vulkan.__file__]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return "the Vulkan driver did not answer for 60 s"
    if done.returncode != 0:
        return f"asking for Vulkan devices ended with code {done.returncode}"
    return done.stdout.strip() or None


EXPOSURE = 4.0
"""Factor on all lamps: how much light the camera lets in."""
LINEAR = np.arange(256) / 255
SRGB = np.rint(255 * np.where(LINEAR < 0.0031308, 12.92 * LINEAR, 1.055 * LINEAR ** (1 / 2.4) - 0.055)).astype(np.uint8)
"""Linear 8-bit values to those of a screen (IEC 61966-2-1)."""


class FilamentRenderer:
    """Renders RGB frames of one model, seen by the task's camera, with shadows. Called like a ``FrameRenderer``.

    Filament's own post-processing is off: it jitters from frame to frame, so that the same state would never give the
    same image twice. What it does for brightness is done here.

    Args:
        model: compiled model with a camera named ``"view"``.
        size: height and width in pixels.
    """

    _open: ClassVar[FilamentRenderer | None] = None  # the shapes of two models at a time are an error in Filament

    def __init__(self, model: mujoco.MjModel, size: int) -> None:
        self.size, self._model = size, copy.copy(model)
        self._model.light_diffuse *= EXPOSURE
        self._model.light_ambient *= EXPOSURE
        self._model.light_specular *= EXPOSURE
        self._picture = np.zeros((size, size, 3), np.uint8)
        # The classic scene gives the camera: fixed and tracking ones, and View's off-centre windows, work alike.
        self._viewed = mujoco.MjvScene(model, maxgeom=model.ngeom + 1000)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(CAMERA).id

    def __call__(self, data: mujoco.MjData, out: np.ndarray | None = None) -> np.ndarray:
        """Render ``data``. Returns uint8 (size, size, 3), written into ``out`` if given."""
        context = _context()
        if FilamentRenderer._open is not self:
            if FilamentRenderer._open is not None:
                FilamentRenderer._open.close()
            self._fill(context)
        self._lights.update(data)
        self._shapes.update(data)
        self._request.camera = self._seen_from(data)
        context.wait_for_frame(context.render([self._request], [self._read]))
        return np.take(SRGB, self._picture, out=out, mode="clip")

    def _fill(self, context: Any) -> None:
        """Give the engine the model. Each of these is needed by those after it, and nothing else keeps it alive."""
        from mujoco import mjrf

        self._scene = context.create_scene(mjrf.SceneParams())
        self._scene.configure_from_model(self._model)
        self._scene.set_msaa(4)
        self._resources = mjrf.ModelResources(context, self._model)
        self._lights = mjrf.ModelLights(self._scene, self._resources)
        self._shapes = mjrf.ModelRenderables(self._scene, self._resources)
        size, rgb = self.size, mjrf.PixelFormat.PIXEL_FORMAT_RGB8
        self._target = context.create_render_target(mjrf.RenderTargetConfig(width=size, height=size, color_format=rgb))
        self._read = mjrf.ReadRequest(target=self._target)
        self._read.set_buffer(self._picture)
        self._request = mjrf.RenderRequest(scene=self._scene, target=self._target, shadows=True)
        self._request.post_processing = self._request.reflections = False
        self._request.viewport.width = self._request.viewport.height = size
        FilamentRenderer._open = self

    def close(self) -> None:
        """Free what is on the device, users before what they use."""
        if FilamentRenderer._open is self:
            for name in ("_request", "_read", "_target", "_shapes", "_lights", "_resources", "_scene"):
                setattr(self, name, None)
            FilamentRenderer._open = None

    def _seen_from(self, data: mujoco.MjData) -> Any:
        from mujoco import mjrf

        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, everything, self._viewed)
        left, right = self._viewed.camera  # the two eyes of a stereo image
        names = ("forward", "up", "frustum_center", "frustum_width", "frustum_bottom", "frustum_top")
        kept = {k: getattr(left, k) for k in (*names, "frustum_near", "frustum_far")}
        return mjrf.Camera(pos=(left.pos + right.pos) / 2, **kept)


@functools.cache
def _context() -> Any:
    """The process's one Filament engine."""
    from mujoco import mjrf
    from mujoco.experimental.studio import window  # noqa: F401  registers Filament's materials

    atexit.register(_shut_down)  # in any other order, the end of the process is a crash
    with silence():
        return mjrf.Context(mjrf.ContextConfig(graphics_api=mjrf.GraphicsApi.GRAPHICS_API_VULKAN))


def _shut_down() -> None:
    if FilamentRenderer._open is not None:
        FilamentRenderer._open.close()
    _context.cache_clear()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep what a library in C++ prints off this process's output."""
    sys.stdout.flush(), sys.stderr.flush()
    kept = [os.dup(fd) for fd in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in (1, 2):
            os.dup2(nowhere, fd)
        yield
    finally:
        for fd, old in zip((1, 2), kept, strict=True):
            os.dup2(old, fd)
            os.close(old)
        os.close(nowhere)

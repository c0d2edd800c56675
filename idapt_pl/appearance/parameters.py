"""What about a picture can be wrong: camera, lights, colours, sky, blur, each as numbers that a renderer can be given.

A parameter says the same thing twice: to a renderer, at once and without compiling the model anew, and as effects
(:mod:`idapt_pl.effects.visual`), for ``effects.yaml``. A test holds the two together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from idapt_pl.appearance.scene import camera_distance, geoms_by_colour, sky_gradient, sky_pixels, sky_texture
from idapt_pl.effects import Effect
from idapt_pl.effects.visual import CAMERA, Blur, CameraFrame, Color, Light, Texture, blur_of, blurred


@dataclass(frozen=True, eq=False)
class VisualParameter(ABC):
    """One thing that may be different about the pictures: ``d`` numbers that a renderer can be given.

    Attributes:
        target: as of the effect; several geoms of one colour are separated by spaces.
        levels: how much both pictures are blurred while it is fitted, one after the other, as shares of their side.
        rank: parameters of a higher rank are tried when those of lower ones help no more.
        nominal: values (d,) where the search starts; those of the model, if it has such values.
        step: change (d,) that moves the picture noticeably, for finite differences.
        low: bounds (d,).
        high: bounds (d,).
    """

    name: ClassVar[str]
    labels: ClassVar[tuple[str, ...]]
    levels: ClassVar[tuple[float, ...]] = (0.0,)
    rank: ClassVar[int] = 0
    unit: ClassVar[str]
    target: str
    nominal: np.ndarray
    step: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def key(self) -> tuple[str, str]:
        """Effect and target."""
        return self.name, self.target

    def apply_to_model(self, model: mujoco.MjModel, values: np.ndarray) -> None:  # noqa: B027  most edit one of three
        """Edit a compiled model; ``values`` (d,), as in the methods below."""

    def apply_to_state(self, data: mujoco.MjData, values: np.ndarray) -> None:  # noqa: B027
        """Edit what was computed for one state."""

    def apply_to_picture(self, picture: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Edit a rendered picture (H, W, 3), or a mean of such."""
        return picture

    @abstractmethod
    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        """The same as effects on the model."""

    def by_label(self, values: np.ndarray) -> dict[str, float]:
        """Label to value."""
        return dict(zip(self.labels, values.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class CameraParameter(VisualParameter):
    """The camera shifted [m] and turned [rad] along its own axes: right, up, back."""

    name = "camera_frame"
    labels = ("right", "up", "back", "pitch", "yaw", "roll")
    # A camera that stands elsewhere is found by blurred pictures, whose slopes reach as far as it was moved.
    rank = 1
    levels = (0.08, 0.04, 0.02, 0.0)
    unit = "m, rad"

    def apply_to_state(self, data: mujoco.MjData, values: np.ndarray) -> None:
        camera = data.camera(CAMERA)
        axes = camera.xmat.reshape(3, 3).copy()
        camera.xpos += axes @ values[:3]
        camera.xmat[:] = (axes @ Rotation.from_rotvec(values[3:]).as_matrix()).ravel()

    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        model = spec.copy().compile()
        camera = model.camera(CAMERA)
        axes = Rotation.from_quat(camera.quat, scalar_first=True)
        position = camera.pos + axes.apply(values[:3])
        quat = (axes * Rotation.from_rotvec(values[3:])).as_quat(scalar_first=True)
        pose = {"position": tuple(map(float, position)), "quat": tuple(map(float, quat))}
        return (CameraFrame(CAMERA, **pose, fovy=float(camera.fovy[0])),)


@dataclass(frozen=True, eq=False)
class LightParameter(VisualParameter):
    """What a light gives off: diffuse and ambient colour."""

    name = "light"
    labels = ("diffuse red", "diffuse green", "diffuse blue", "ambient red", "ambient green", "ambient blue")
    unit = "1"

    def apply_to_model(self, model: mujoco.MjModel, values: np.ndarray) -> None:
        if self.target == "headlight":
            model.vis.headlight.diffuse, model.vis.headlight.ambient = values[:3], values[3:]
        else:
            light = model.light(self.target).id
            model.light_diffuse[light], model.light_ambient[light] = values[:3], values[3:]

    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        return (Light(self.target, diffuse=round_colour(values[:3]), ambient=round_colour(values[3:])),)


@dataclass(frozen=True, eq=False)
class ColorParameter(VisualParameter):
    """The colour of geoms that have the same one; whatever was painted on them is gone."""

    name = "color"
    labels = ("red", "green", "blue")
    unit = "1"

    def apply_to_model(self, model: mujoco.MjModel, values: np.ndarray) -> None:
        for geom in self.target.split():
            i = model.geom(geom).id
            model.geom_matid[i] = -1
            model.geom_rgba[i, :3] = values

    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        return tuple(Color(geom, (*round_colour(values), 1.0)) for geom in self.target.split())


@dataclass(frozen=True, eq=False)
class SkyParameter(VisualParameter):
    """A sky that fades from one colour, overhead, to another. The compiled model must have a texture for it."""

    name = "texture"
    labels = ("red", "green", "blue", "red below", "green below", "blue below")
    unit = "1"

    def apply_to_model(self, model: mujoco.MjModel, values: np.ndarray) -> None:
        sky = sky_pixels(model)
        i = sky_texture(model)
        share = sky_gradient(int(model.tex_width[i]), int(model.tex_height[i]))
        sky[:] = np.rint(255 * (share * values[:3] + (1 - share) * values[3:]))

    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        return (Texture("sky", flat=round_colour(values[:3]), fade_to=round_colour(values[3:])),)


@dataclass(frozen=True, eq=False)
class BlurParameter(VisualParameter):
    """How much the pictures are blurred, as a variance, so that its slope at zero is not zero."""

    name = "blur"
    labels = ("variance",)
    rank = 2
    unit = "(% of the side)²"

    def apply_to_picture(self, picture: np.ndarray, values: np.ndarray) -> np.ndarray:
        return blurred(picture, self._sigma(values))

    def effects(self, spec: mujoco.MjSpec, values: np.ndarray) -> tuple[Effect, ...]:
        return (Blur("world", self._sigma(values)),)

    @staticmethod
    def _sigma(values: np.ndarray) -> float:
        return 0.01 * float(np.sqrt(values[0]))


def round_colour(values: np.ndarray) -> tuple[float, ...]:
    """Colours to a tenth of what eight bits can tell."""
    return tuple(round(float(v), 4) for v in values)


def visual_parameters(spec: mujoco.MjSpec) -> list[VisualParameter]:
    """Everything that may be different about the pictures of a model.

    Geoms without a name cannot be named in an effect, and are left as they are.
    """
    model = spec.copy().compile()
    reach = np.array([camera_distance(model)] * 3 + [1.0] * 3)
    camera = CameraParameter(CAMERA, np.zeros(6), 0.01 * reach, -0.5 * reach, 0.5 * reach)
    variance = np.array([(100 * blur_of(model)) ** 2])
    blur = BlurParameter("world", variance, np.array([0.5]), np.zeros(1), np.array([400.0]))
    headlight = model.vis.headlight
    lights = [light_parameter("headlight", headlight.diffuse, headlight.ambient)]
    lights += [light_parameter(one.name, one.diffuse, one.ambient) for one in spec.lights if one.name]
    colours = [
        ColorParameter(names, colour, np.full(3, 0.05), np.zeros(3), np.ones(3))
        for names, colour in geoms_by_colour(model).items()
    ]
    sky = SkyParameter("sky", np.full(6, 0.5), np.full(6, 0.05), np.zeros(6), np.ones(6))
    return [camera, blur, *lights, *colours, sky]


def light_parameter(name: str, diffuse: np.ndarray, ambient: np.ndarray) -> LightParameter:
    """A light of a model with what it gives off there, (3,) each."""
    nominal = np.concatenate([diffuse, ambient]).astype(float)
    return LightParameter(name, nominal, np.full(6, 0.05), np.zeros(6), np.ones(6))

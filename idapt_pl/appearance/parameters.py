"""What about a picture can be wrong: camera, lamps, colours, sky, blur, each as numbers that a renderer can be given.

A knob says the same thing twice: to a renderer, at once and without compiling the model anew, and as effects
(:mod:`idapt_pl.effects.visual`), for ``effects.yaml``. A test holds the two together.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from idapt_pl.effects import Domain, Effect
from idapt_pl.effects.visual import CAMERA, Blur, CameraFrame, Color, Light, Texture, blur_of, blurred

Numbers = np.ndarray


@dataclass(frozen=True, eq=False)
class VisualParameter(ABC):
    """One thing that may be different about the pictures.

    Attributes:
        target: as of the effect; several geoms of one colour are separated by spaces.
        levels: how much both pictures are blurred while it is fitted, one after the other, as shares of their side.
        rank: knobs of a higher rank are tried when those of lower ones help no more.
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
    nominal: Numbers
    step: Numbers
    low: Numbers
    high: Numbers

    @property
    def key(self) -> tuple[str, str]:
        """Effect and target."""
        return self.name, self.target

    def turn(self, model: mujoco.MjModel, values: Numbers) -> None:  # noqa: B027  most knobs edit one of the three
        """Edit a compiled model."""

    def move(self, data: mujoco.MjData, values: Numbers) -> None:  # noqa: B027
        """Edit what was computed for one state."""

    def develop(self, picture: np.ndarray, values: Numbers) -> np.ndarray:
        """Edit a picture (H, W, 3)."""
        return picture

    @abstractmethod
    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        """The same as effects on the model."""


@dataclass(frozen=True, eq=False)
class CameraParameter(VisualParameter):
    """The camera shifted [m] and turned [rad] along its own axes: right, up, back."""

    name = "camera_frame"
    labels = ("right", "up", "back", "pitch", "yaw", "roll")
    # A camera that stands elsewhere is found by blurred pictures, whose slopes reach as far as it was moved.
    rank = 1
    levels = (0.08, 0.04, 0.02, 0.0)
    unit = "m, rad"

    def move(self, data: mujoco.MjData, values: Numbers) -> None:
        camera = data.camera(CAMERA)
        axes = camera.xmat.reshape(3, 3).copy()
        camera.xpos += axes @ values[:3]
        camera.xmat[:] = (axes @ Rotation.from_rotvec(values[3:]).as_matrix()).ravel()

    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        model = spec.copy().compile()
        camera = model.camera(CAMERA)
        axes = Rotation.from_quat(camera.quat, scalar_first=True)
        position = camera.pos + axes.apply(values[:3])
        quat = (axes * Rotation.from_rotvec(values[3:])).as_quat(scalar_first=True)
        pose = {"position": tuple(map(float, position)), "quat": tuple(map(float, quat))}
        return (CameraFrame(CAMERA, **pose, fovy=float(camera.fovy[0])),)


@dataclass(frozen=True, eq=False)
class LampParameter(VisualParameter):
    """What a lamp gives: diffuse and ambient light."""

    name = "light"
    labels = ("diffuse red", "diffuse green", "diffuse blue", "ambient red", "ambient green", "ambient blue")
    unit = "1"

    def turn(self, model: mujoco.MjModel, values: Numbers) -> None:
        if self.target == "headlight":
            model.vis.headlight.diffuse, model.vis.headlight.ambient = values[:3], values[3:]
        else:
            light = model.light(self.target).id
            model.light_diffuse[light], model.light_ambient[light] = values[:3], values[3:]

    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        return (Light(self.target, diffuse=rounded(values[:3]), ambient=rounded(values[3:])),)


@dataclass(frozen=True, eq=False)
class ColorParameter(VisualParameter):
    """The colour of geoms that have the same one; whatever was painted on them is gone."""

    name = "color"
    labels = ("red", "green", "blue")
    unit = "1"

    def turn(self, model: mujoco.MjModel, values: Numbers) -> None:
        for geom in self.target.split():
            i = model.geom(geom).id
            model.geom_matid[i] = -1
            model.geom_rgba[i, :3] = values

    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        return tuple(Color(geom, (*rounded(values), 1.0)) for geom in self.target.split())


@dataclass(frozen=True, eq=False)
class SkyParameter(VisualParameter):
    """A sky that fades from one colour, overhead, to another. The compiled model must have a texture for it."""

    name = "texture"
    labels = ("red", "green", "blue", "red below", "green below", "blue below")
    unit = "1"

    def turn(self, model: mujoco.MjModel, values: Numbers) -> None:
        sky = sky_pixels(model)
        i = sky_texture(model)
        share = fading(int(model.tex_width[i]), int(model.tex_height[i]))
        sky[:] = np.rint(255 * (share * values[:3] + (1 - share) * values[3:]))

    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        return (Texture("sky", flat=rounded(values[:3]), fade_to=rounded(values[3:])),)


@functools.cache
def fading(width: int, height: int) -> np.ndarray:
    """Share of the first colour in each pixel (n, 1) of MuJoCo's fading sky of that size, as compiled."""
    spec = mujoco.MjSpec()
    kinds = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT}
    spec.add_texture(name="sky", width=width, height=height, rgb1=(1, 1, 1), rgb2=(0, 0, 0), **kinds)
    return sky_pixels(spec.compile())[:, :1] / 255


@dataclass(frozen=True, eq=False)
class BlurParameter(VisualParameter):
    """How much the pictures are blurred, as a variance, so that its slope at zero is not zero."""

    name = "blur"
    labels = ("variance",)
    rank = 2
    unit = "(% of the side)²"

    def develop(self, picture: np.ndarray, values: Numbers) -> np.ndarray:
        return blurred(picture, self._sigma(values))

    def effects(self, spec: mujoco.MjSpec, values: Numbers) -> tuple[Effect, ...]:
        return (Blur("world", self._sigma(values)),)

    @staticmethod
    def _sigma(values: Numbers) -> float:
        return 0.01 * float(np.sqrt(values[0]))


def rounded(values: Numbers) -> tuple[float, ...]:
    """Colours to a tenth of what eight bits can tell."""
    return tuple(round(float(v), 4) for v in values)


def sky_texture(model: mujoco.MjModel) -> int | None:
    """Number of the sky's texture; None if the model has no sky."""
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    return int(skies[0]) if len(skies) else None


def sky_pixels(model: mujoco.MjModel) -> np.ndarray:
    """The sky's texture (n, 3), to be edited in place; none if the model has no sky."""
    if (i := sky_texture(model)) is None:
        return np.zeros((0, 3), np.uint8)
    size = model.tex_height[i] * model.tex_width[i] * model.tex_nchannel[i]
    return model.tex_data[model.tex_adr[i] :][:size].reshape(-1, model.tex_nchannel[i])[:, :3]


def visual_parameters(spec: mujoco.MjSpec) -> list[VisualParameter]:
    """Everything that may be different about the pictures of a model.

    Geoms without a name cannot be named in an effect, and are left as they are.
    """
    model = spec.copy().compile()
    one = np.ones(3)
    reach = np.array([camera_distance(model)] * 3 + [1.0] * 3)
    camera = CameraParameter(CAMERA, np.zeros(6), 0.01 * reach, -0.5 * reach, 0.5 * reach)
    found: list[VisualParameter] = [
        camera,
        BlurParameter(
            "world", np.full(1, (100 * blur_of(model)) ** 2), np.full(1, 0.5), np.zeros(1), np.full(1, 400.0)
        ),
    ]

    def lamp(name: str, diffuse: np.ndarray, ambient: np.ndarray) -> LampParameter:
        return LampParameter(
            name, np.concatenate([diffuse, ambient]).astype(float), np.full(6, 0.05), np.zeros(6), np.ones(6)
        )

    found.append(lamp("headlight", model.vis.headlight.diffuse, model.vis.headlight.ambient))
    found += [lamp(light.name, light.diffuse, light.ambient) for light in spec.lights if light.name]
    for names, colour in same_colours(model).items():
        found.append(ColorParameter(names, colour, 0.05 * one, 0 * one, one))
    found.append(SkyParameter("sky", np.full(6, 0.5), np.full(6, 0.05), np.zeros(6), np.ones(6)))
    return found


def with_sky(domain: Domain) -> Domain:
    """The domain with a sky that can be painted anew; where it has none it is black, which looks the same."""
    if any(t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in domain.spec().textures):
        return domain

    def base() -> mujoco.MjSpec:
        spec = domain.spec()
        flat = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_FLAT}
        spec.add_texture(name="sky", width=32, height=32, rgb1=(0, 0, 0), rgb2=(0, 0, 0), **flat)
        return spec

    return Domain(domain.name, base)


def camera_distance(model: mujoco.MjModel) -> float:
    """From the camera to the middle of what moves [m]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moving = data.xipos[1:][model.body_mass[1:] > 0]
    return float(np.linalg.norm(data.camera(CAMERA).xpos - moving.mean(0)))


def same_colours(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Names of visible geoms that share a colour or a material, and each name alone, to that colour (3,)."""
    groups: dict[tuple, list[str]] = {}
    for i in range(model.ngeom):
        material = int(model.geom_matid[i])
        rgba = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        if model.geom(i).name and model.geom_group[i] < 3 and rgba[3] > 0:
            groups.setdefault((material, *map(float, rgba)), []).append(model.geom(i).name)
    together = {" ".join(names): np.array(key[1:4]) for key, names in groups.items()}
    return together | {name: colour for names, colour in together.items() for name in names.split()}

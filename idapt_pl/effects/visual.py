"""Visual effects: what changes an image and leaves the motion alone."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter

from idapt_pl.effects.base import Effect, find_elements, parameter
from idapt_pl.effects.packaged import packaged_file

CAMERA = "view"
"""Name of the camera that every task defines and every image is taken with."""


def orbit_axes(azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray]:
    """Viewing direction and camera x/y axes of MuJoCo's free camera, angles in degrees.

    Returns:
        forward: unit vector from the camera to what it looks at, shape (3,).
        xyaxes: camera x axis (right) and y axis (up) in the world, shape (6,).
    """
    az, el = np.deg2rad(azimuth), np.deg2rad(elevation)
    forward = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([np.sin(az), -np.cos(az), 0.0])
    return forward, np.concatenate([right, np.cross(right, forward)])


@dataclass(frozen=True)
class VisualEffect(Effect):
    """An effect on images alone. A diagnosis of motion cannot see it: :mod:`idapt_pl.appearance` looks for it."""

    searched: ClassVar[bool] = False


@dataclass(frozen=True)
class CameraPose(VisualEffect):
    """Where the camera stands: an orbit around ``lookat`` as in MuJoCo's viewer."""

    name: ClassVar[str] = "camera_pose"
    phrase: ClassVar[str] = "viewpoint of camera"
    azimuth: float = parameter("deg", -360.0, 360.0)
    elevation: float = parameter("deg", -90.0, 90.0)
    distance: float = parameter("m", 1e-3, 1e3)
    lookat: tuple[float, float, float] = parameter("m", -1e3, 1e3)
    fovy: float = parameter("deg", 0.0, 180.0, default=45.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        forward, xyaxes = orbit_axes(self.azimuth, self.elevation)
        for camera in find_elements(spec, "cameras", self.target):
            camera.pos = np.asarray(self.lookat) - self.distance * forward
            camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
            camera.alt.xyaxes = xyaxes
            camera.fovy = self.fovy


@dataclass(frozen=True)
class CameraFrame(VisualEffect):
    """Where the camera stands, in its body's frame: a position, and MJCF's ``xyaxes`` (right and up) or ``quat``."""

    name: ClassVar[str] = "camera_frame"
    phrase: ClassVar[str] = "position and direction of camera"
    position: tuple[float, float, float] = parameter("m", -1e3, 1e3, default=(0.0, 0.0, 0.0))
    xyaxes: tuple[float, float, float, float, float, float] | None = parameter("1", -1e3, 1e3, default=None)
    quat: tuple[float, float, float, float] | None = parameter("1", -1e3, 1e3, default=None)
    fovy: float = parameter("deg", 0.0, 180.0, default=45.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        if (self.xyaxes is None) == (self.quat is None):
            raise ValueError(f"camera_frame on {self.target!r}: give either xyaxes or quat")
        for camera in find_elements(spec, "cameras", self.target):
            camera.pos, camera.fovy = self.position, self.fovy
            if self.quat is not None:
                camera.alt.type, camera.quat = mujoco.mjtOrientation.mjORIENTATION_QUAT, self.quat
            else:
                camera.alt.type, camera.alt.xyaxes = mujoco.mjtOrientation.mjORIENTATION_XYAXES, self.xyaxes


@dataclass(frozen=True)
class Light(VisualEffect):
    """Light colours. Target ``"headlight"`` is the light at the camera; any other name is a lamp.

    A lamp that the model lacks is added, at ``position``, shining straight down or in ``direction``. ``kind`` is
    ``"spot"``, a cone from that position, or ``"directional"``.
    """

    name: ClassVar[str] = "light"
    phrase: ClassVar[str] = "colour of light"
    diffuse: tuple[float, float, float] | None = parameter("1", 0.0, 1.0, default=None)
    ambient: tuple[float, float, float] | None = parameter("1", 0.0, 1.0, default=None)
    specular: tuple[float, float, float] | None = parameter("1", 0.0, 1.0, default=None)
    position: tuple[float, float, float] | None = parameter("m", -1e6, 1e6, default=None)
    direction: tuple[float, float, float] | None = parameter("1", -1e6, 1e6, default=None)
    kind: str | None = None

    def apply(self, spec: mujoco.MjSpec) -> None:
        kinds = {"spot": mujoco.mjtLightType.mjLIGHT_SPOT, "directional": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL}
        if self.kind is not None and self.kind not in kinds:
            raise ValueError(f"light: kind must be one of {', '.join(kinds)}, got {self.kind!r}")
        light: Any = spec.visual.headlight if self.target == "headlight" else self._lamp(spec)
        for channel in ("diffuse", "ambient", "specular"):
            if getattr(self, channel) is not None:
                setattr(light, channel, getattr(self, channel))
        if self.kind is not None:
            light.type = kinds[self.kind]

    def _lamp(self, spec: mujoco.MjSpec) -> Any:
        lamp = spec.light(self.target) or spec.worldbody.add_light(name=self.target, dir=[0, 0, -1])
        if self.position is not None:
            lamp.pos = self.position
        if self.direction is not None:
            lamp.dir = self.direction
        return lamp


@dataclass(frozen=True)
class Color(VisualEffect):
    """Colour of a geom."""

    name: ClassVar[str] = "color"
    phrase: ClassVar[str] = "colour of geom"
    rgba: tuple[float, float, float, float] = parameter("1", 0.0, 1.0)

    def apply(self, spec: mujoco.MjSpec) -> None:
        for geom in find_elements(spec, "geoms", self.target):
            geom.material = ""
            geom.rgba = self.rgba


@dataclass(frozen=True)
class Material(VisualEffect):
    """What a geom is painted with: a material of dm_control's suite, or a picture that metaworld ships."""

    name: ClassVar[str] = "material"
    phrase: ClassVar[str] = "material of geom"
    dm_control: str | None = None  # in dm_control/suite/common/materials.xml, for example grid
    picture: str | None = None  # in metaworld/assets/textures, for example wood2.png
    repeat: tuple[float, float] = parameter("1", 0.0, 1e4, default=(1.0, 1.0))  # of a picture

    def apply(self, spec: mujoco.MjSpec) -> None:
        given = [name for name in (self.dm_control, self.picture) if name is not None]
        if len(given) != 1:
            raise ValueError(f"material on {self.target!r}: give either dm_control or picture")
        (name,) = given
        if spec.material(name) is None:
            copy_material(dm_control_assets("materials.xml"), spec, name) if self.dm_control else self._add(spec, name)
        for geom in find_elements(spec, "geoms", self.target):
            geom.material = name
            geom.rgba = (0.5, 0.5, 0.5, 1)  # MJCF's default: the material's own colour counts

    def _add(self, spec: mujoco.MjSpec, name: str) -> None:
        spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_CUBE, file=picture_file(name))
        material = spec.add_material(name=name, texrepeat=self.repeat, specular=0.2)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def picture_file(name: str) -> str:
    """Path of one of the pictures that metaworld ships."""
    return str(packaged_file("metaworld", f"assets/textures/{name}"))


def dm_control_assets(file: str) -> mujoco.MjSpec:
    """One of the files of assets that dm_control's suite shares."""
    return mujoco.MjSpec.from_string((importlib.resources.files("dm_control") / "suite/common" / file).read_text())


def copy_material(source: mujoco.MjSpec, spec: mujoco.MjSpec, name: str) -> None:
    """Copy a material and its procedural texture from one model to another."""
    material = source.material(name)
    if material is None:
        raise ValueError(f"there is no material {name!r}; there are: {', '.join(m.name for m in source.materials)}")
    new = spec.add_material(name=name)
    for k in ("rgba", "emission", "specular", "shininess", "reflectance", "texrepeat", "texuniform", "textures"):
        setattr(new, k, getattr(material, k))
    for texture in filter(None, material.textures):
        old = source.texture(texture)
        settings = {
            k: getattr(old, k) for k in ("type", "builtin", "rgb1", "rgb2", "mark", "markrgb", "width", "height")
        }
        spec.add_texture(name=texture, **settings)


@dataclass(frozen=True)
class Texture(VisualEffect):
    """What is painted on the sky: one colour, or a fading one, or a dm_control skybox. Target is ``"sky"``."""

    name: ClassVar[str] = "texture"
    phrase: ClassVar[str] = "texture of the"
    flat: tuple[float, float, float] | None = parameter("1", 0.0, 1.0, default=None)
    fade_to: tuple[float, float, float] | None = parameter("1", 0.0, 1.0, default=None)
    dm_control: str | None = None  # file in dm_control/suite/common, for example skybox.xml

    def apply(self, spec: mujoco.MjSpec) -> None:
        if self.target != "sky":
            raise ValueError(f"texture: target must be 'sky', got {self.target!r}")
        for old in [t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX]:
            spec.delete(old)
        if self.dm_control is not None:
            sky = dm_control_assets(self.dm_control).textures[0]
            settings = {k: getattr(sky, k) for k in ("builtin", "rgb1", "rgb2", "mark", "markrgb", "random")}
        else:
            kind = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT if self.fade_to else mujoco.mjtBuiltin.mjBUILTIN_FLAT
            settings = {"builtin": kind, "rgb1": self.flat, "rgb2": self.fade_to or self.flat}
        spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=256, height=1536, **settings)


@dataclass(frozen=True)
class Scenery(VisualEffect):
    """A furnished room around the robot. It is seen and touches nothing. Target is ``"world"``.

    The room is an MJCF file in ``idapt_pl/effects/scenery``; its pictures are metaworld's.
    """

    name: ClassVar[str] = "scenery"
    phrase: ClassVar[str] = "scenery around the robot"
    room: str = "interior"
    position: tuple[float, float, float] = parameter("m", -1e3, 1e3, default=(0.0, 0.0, 0.0))

    def apply(self, spec: mujoco.MjSpec) -> None:
        rooms = importlib.resources.files("idapt_pl.effects") / "scenery"
        room = mujoco.MjSpec.from_string((rooms / f"{self.room}.xml").read_text())
        for texture in room.textures:
            texture.file = picture_file(texture.file)
        spec.attach(room, prefix=f"{self.room}/", frame=spec.worldbody.add_frame(pos=self.position))


ENGINE = "renderer"
"""Name of the model's text that says what draws it."""


@dataclass(frozen=True)
class Renderer(VisualEffect):
    """What draws the images: ``filament``, or MuJoCo's ``classic`` renderer, the default. Target is ``"world"``."""

    name: ClassVar[str] = "renderer"
    phrase: ClassVar[str] = "renderer of the images"
    engine: str = "classic"

    def apply(self, spec: mujoco.MjSpec) -> None:
        if self.engine not in ("classic", "filament"):
            raise ValueError(f"renderer: engine must be classic or filament, got {self.engine!r}")
        spec.add_text(name=ENGINE, data=self.engine)


BLUR = "blur"
"""Name of the model's number that says how much its images are blurred."""


@dataclass(frozen=True)
class Blur(VisualEffect):
    """How much images are blurred: a Gaussian, its spread as a share of the image's side. Target is ``"world"``."""

    name: ClassVar[str] = "blur"
    phrase: ClassVar[str] = "blur of the images"
    sigma: float = parameter("1", 0.0, 0.5)

    def apply(self, spec: mujoco.MjSpec) -> None:
        number = spec.numeric(BLUR) or spec.add_numeric(name=BLUR, size=1)
        number.data = [self.sigma]


def blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    """A picture (H, W, 3), blurred by a Gaussian of ``sigma`` times its side."""
    width = sigma * len(picture)
    return gaussian_filter(picture, (width, width, 0), mode="nearest") if sigma > 0 else picture


def engine_of(model: mujoco.MjModel) -> str:
    """What a model asks to be drawn by: ``classic`` unless it says otherwise."""
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, ENGINE)
    if i < 0:
        return "classic"
    start = model.text_adr[i]
    return bytes(model.text_data[start : start + model.text_size[i] - 1]).decode()


def blur_of(model: mujoco.MjModel) -> float:
    """Spread of the Gaussian that a model's images are blurred by, as a share of their side."""
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, BLUR)
    return float(model.numeric_data[model.numeric_adr[i]]) if i >= 0 else 0.0

"""What a compiled model shows: its sky, the colours of its geoms, how far away the camera is."""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.visual import CAMERA


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


@functools.cache
def sky_gradient(width: int, height: int) -> np.ndarray:
    """Share of the first colour in each pixel (n, 1) of MuJoCo's fading sky of that size, as compiled."""
    spec = mujoco.MjSpec()
    kinds = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT}
    spec.add_texture(name="sky", width=width, height=height, rgb1=(1, 1, 1), rgb2=(0, 0, 0), **kinds)
    return sky_pixels(spec.compile())[:, :1] / 255


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
    """From the camera to the middle of what moves, m."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moving = data.xipos[1:][model.body_mass[1:] > 0]
    return float(np.linalg.norm(data.camera(CAMERA).xpos - moving.mean(0)))


def geoms_by_colour(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Names of visible geoms that share a colour or a material, and each name alone, to that colour (3,)."""
    groups: dict[tuple, list[str]] = {}
    for i in range(model.ngeom):
        material = int(model.geom_matid[i])
        rgba = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        if model.geom(i).name and model.geom_group[i] < 3 and rgba[3] > 0:
            groups.setdefault((material, *map(float, rgba)), []).append(model.geom(i).name)
    together = {" ".join(names): np.array(key[1:4]) for key, names in groups.items()}
    return together | {name: colour for names, colour in together.items() for name in names.split()}

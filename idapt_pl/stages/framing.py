"""Whether the robot is in the picture: what no image shows, nothing can read."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from datamodules.trajectories import open_trajectory_file
from idapt_pl.effects import View
from idapt_pl.effects.visual import CAMERA
from idapt_pl.envs.image_env import SHOWN
from idapt_pl.worlds import Worlds

log = logging.getLogger(__name__)

SELDOM, MOSTLY = 0.05, 0.95
"""Shares of the frames. What is out of the picture more seldom does no harm, and what mostly is, is meant to be."""
FRAMES = 500
"""That are looked at, at most."""
CUT_OFF = 0.005
"""Share of the frames that a wider view may still cut, at either side."""
AROUND = 0.01
"""Around all points, in heights of the image, as what they are of has a width."""
VISIBLE_GROUPS = 3
"""MuJoCo draws geoms of the groups below."""

_ENDS = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))


@dataclass(frozen=True)
class Framing:
    """What of a robot leaves the picture.

    Attributes:
        outside: share of the frames in which a part reaches out of the picture, by the geom's or its body's name.
        view: the smallest view in which hardly any of these parts does; None where the camera's whole image is too
            small.
    """

    outside: dict[str, float]
    view: View | None

    def __str__(self) -> str:
        told = ", ".join(f"{name} in {share:.0%}" for name, share in sorted(self.outside.items(), key=lambda o: -o[1]))
        cure = "the camera's whole image is too small: move it back"
        if v := self.view:
            cure = f"view {{share: {v.share:g}, up: {v.up:g}, right: {v.right:g}}} shows them"
        return f"parts of the robot leave the picture: {told} of the frames. What is not seen cannot be read; {cure}"


def warn_if_outside(worlds: Worlds, recording: Path, earlier: Path | None = None) -> None:
    """Say which parts leave the picture in a recording of the source with ``simulation``, and which view shows them.

    Args:
        worlds: of the run.
        recording: trajectory file.
        earlier: the one of the step before. If no other parts left the picture there, it has been said.
    """
    found = framing_of(worlds, recording)
    known = framing_of(worlds, earlier).outside if found.outside and earlier is not None and earlier.exists() else {}
    if found.outside.keys() - known.keys():
        log.warning("%s", found)


def framing_of(worlds: Worlds, recording: Path) -> Framing:
    """What leaves the picture in a recording of the source; nothing if it has no ``simulation``."""
    with open_trajectory_file(recording) as f:  # its images, which take longest to read, are not looked at
        observations = [group["observations"] for name, group in f.items() if name.startswith("episode_")]
        simulations = [shown["simulation"][()] for shown in observations if "simulation" in shown]
    if not simulations:
        return Framing({}, None)  # of a run of an earlier version
    rows = np.concatenate(simulations)
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), FRAMES)).astype(int)]
    return framing(worlds.source_domain.compile(), chosen, worlds.view)


def framing(model: mujoco.MjModel, simulations: Iterable[np.ndarray], view: View) -> Framing:
    """What leaves the picture.

    Args:
        model: with the camera's whole image.
        simulations: as :meth:`.VectorImageEnv.restore` takes them.
        view: the part of the image that is rendered.
    """
    if not (geoms := drawn_geoms(model)):
        return Framing({}, None)
    points = np.array([seen_at(model, row, geoms) for row in simulations]).reshape(-1, len(geoms), 3, 2)
    out = (np.abs(points - [view.right, view.up]) > view.share / 2).any((2, 3)).mean(0)
    partly = (out > SELDOM) & (out < MOSTLY)
    names = [model.geom(g).name or model.body(model.geom_bodyid[g]).name for g in geoms]
    outside: dict[str, float] = {}
    for name, share in zip(np.array(names)[partly], out[partly], strict=True):
        outside[str(name)] = max(outside.get(str(name), 0.0), float(share))
    return Framing(outside, wide_enough(points[:, out < MOSTLY].reshape(-1, 2)) if outside else None)


def wide_enough(points: np.ndarray) -> View | None:
    """The smallest view with nearly all points (n, 2), to the next hundredth; None if it is wider than the image."""
    (left, bottom), (right, top) = np.quantile(points, [CUT_OFF, 1 - CUT_OFF], axis=0)
    middle, above = (round(float(ends) / 2, 2) + 0.0 for ends in (left + right, top + bottom))  # 0.0 for -0.0
    share = np.ceil(200 * (AROUND + max(middle - left, right - middle, top - above, above - bottom))) / 100
    return View(float(share), above, middle) if share <= 1 else None


def drawn_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that are drawn and whose bodies move."""
    return [
        g for g in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[g]] and model.geom_group[g] < VISIBLE_GROUPS and model.geom_rgba[g, 3]
    ]  # fmt: skip


def seen_at(model: mujoco.MjModel, simulation: np.ndarray, geoms: list[int]) -> np.ndarray:
    """Where in the image a geom's middle and its ends are, (g, 3, 2): right and up from its middle, in its heights."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, simulation, SHOWN)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    axes = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2]
    half = [model.geom_size[g, 1] if model.geom_type[g] in _ENDS else 0.0 for g in geoms]
    reach = axes * np.array(half)[:, None]
    middle, camera = data.geom_xpos[geoms], model.camera(CAMERA).id
    points = np.stack([middle, middle + reach, middle - reach], 1) - data.cam_xpos[camera]
    right, up, back = np.moveaxis(points @ data.cam_xmat[camera].reshape(3, 3), -1, 0)
    height = 2 * np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    return np.stack([right, up], -1) / (np.maximum(-back, 1e-6) * height)[..., None]

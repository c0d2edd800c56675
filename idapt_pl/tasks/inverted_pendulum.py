"""InvertedPendulum: balance a pole on a cart (Gymnasium's model; differences as in Table I)."""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping

import mujoco
import numpy as np

from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.domain import Domain
from idapt_pl.effects.visual import CAMERA, CameraPose, Color, Light, Texture
from idapt_pl.tasks.recipe import ExpertRecipe
from idapt_pl.tasks.task import Task


class InvertedPendulum(Task):
    """State: cart position [m], pole angle [rad], their velocities; shape (4,). Reward 1 while |angle| <= 0.2."""

    name = "inverted_pendulum"
    frame_skip = 2
    horizon = 1000
    expert = ExpertRecipe(steps=8_000, updates_per_step=2)
    rates: Mapping[int, int] = {2: 0, 3: 1}

    def base(self) -> mujoco.MjSpec:
        xml = importlib.resources.files("gymnasium") / "envs/mujoco/assets/inverted_pendulum.xml"
        spec = mujoco.MjSpec.from_string(xml.read_text())
        spec.worldbody.add_camera(name=CAMERA)
        return spec

    def domains(self) -> dict[str, Domain]:
        # Set explicitly, since MuJoCo's versions differ on this capsule: 4.895 kg is the paper's, 5.019 kg what
        # MuJoCo 3 computes.
        camera = CameraPose(CAMERA, azimuth=90, elevation=-45, distance=2.04, lookat=(0, 0, 0))
        source = Domain("source", self.base, (camera, BodyMass("pole", 4.895)))
        easy = source.with_effects(
            BodyMass("pole", 50.0),
            Color("cpole", (0, 0.7, 0.7, 1)),
            Texture("sky", flat=(0.1, 0.1, 0.1)),
            Light("headlight", diffuse=(0.8, 0.6, 0.4), ambient=(0.4, 0.3, 0.2), specular=(0, 0, 0)),
        )
        hard = source.with_effects(
            BodyMass("pole", 200.0),
            CameraPose(CAMERA, azimuth=100, elevation=-55, distance=2.04, lookat=(0, 0, 0)),
            Texture("sky", dm_control="skybox.xml"),
            Color("rail", (0, 0.4, 0.6, 1)),
            Color("cart", (0.7, 0.4, 0, 1)),
            Color("cpole", (0.7, 0, 0.7, 1)),
            Light("lamp", diffuse=(0.7, 0.7, 0.7), ambient=(0, 0, 0), specular=(0.3, 0.3, 0.3), position=(0, 0, 1.5)),
            Light("headlight", diffuse=(0.6, 0.6, 0.6), ambient=(0.3, 0.3, 0.3), specular=(0, 0, 0)),
        )
        return {d.name: d for d in (source, easy.named("easy"), hard.named("hard"))}

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        data.qpos[:] = model.qpos0 + rng.uniform(-0.01, 0.01, model.nq)
        data.qvel[:] = rng.uniform(-0.01, 0.01, model.nv)

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        return np.concatenate([data.qpos, data.qvel])

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        return states[:, :2], states[:, 2:]

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        fallen = not np.isfinite(data.qpos).all() or abs(data.qpos[1]) > 0.2
        return float(not fallen), bool(fallen)

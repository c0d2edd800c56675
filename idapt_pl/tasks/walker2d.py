"""Walker2d: walk on two legs without falling (Gymnasium's model; differences as in Table I)."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.visual import CAMERA, CameraFrame, Color, Light, Texture
from idapt_pl.tasks.locomotion import DM_CONTROL_LOOK, Locomotion
from idapt_pl.tasks.recipe import ExpertRecipe


class Walker2d(Locomotion):
    """State (17,), actions (6,): see :class:`Locomotion`. Reward: speed, 1 a step, less 0.001 of the squared action.

    Gymnasium's ``walker2d.xml``, not its ``walker2d_v5.xml``: friction 0.9 of the right foot and 1.9 of the left, as
    when the paper was written.
    """

    name = "walker2d"
    frame_skip = 4
    xml = "walker2d.xml"
    alive = 1.0
    control_cost = 1e-3
    velocity_limit = 10.0
    expert = ExpertRecipe(steps=100_000)

    def domains(self) -> dict[str, Domain]:
        # Set explicitly, since MuJoCo's versions differ on this capsule: 3.534 kg is the paper's, 3.665 kg what
        # MuJoCo 3 computes.
        camera = CameraFrame(CAMERA, position=(0, -3, -0.25), xyaxes=(1, 0, 0, 0, 0, 1))
        source = Domain("source", self.base, (camera, BodyMass("torso", 3.534)))
        easy = source.with_effects(
            BodyMass("torso", 5.4),
            Texture("sky", flat=(0.2, 0.3, 0.4)),
            Light("lamp", diffuse=(1, 0.8, 1)),
            Light("headlight", (0.8, 0.6, 0.4), (0.4, 0.3, 0.2), (0, 0, 0)),
        )
        hard = source.with_effects(
            BodyMass("torso", 10.0),
            CameraFrame(CAMERA, position=(0.7, -3, -0.25), xyaxes=(1, 0.2, 0, 0.2, 0, 1)),
            *DM_CONTROL_LOOK,
            Light("headlight", (0.8, 0.8, 0.8), (0.4, 0.4, 0.4), (0.1, 0.1, 0.1)),
            *(Color(geom, (0, 0.6, 0.4, 1)) for geom in ("torso_geom", "thigh_geom", "leg_geom", "foot_geom")),
        )
        return {d.name: d for d in (source, easy.named("easy"), hard.named("hard"))}

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        data.qpos[:] = model.qpos0 + rng.uniform(-5e-3, 5e-3, model.nq)
        data.qvel[:] = rng.uniform(-5e-3, 5e-3, model.nv)

    def upright(self, data: mujoco.MjData) -> bool:
        height, pitch = data.qpos[1:3]
        return bool(0.8 < height < 2.0 and -1.0 < pitch < 1.0)

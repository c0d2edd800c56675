"""HalfCheetah: run forward on two legs (Gymnasium's model; differences as in Table I)."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.base import Effect
from idapt_pl.effects.joints import JointArmature
from idapt_pl.effects.visual import CAMERA, CameraFrame, Color, Light, Texture
from idapt_pl.tasks.locomotion import DM_CONTROL_LOOK, Locomotion
from idapt_pl.tasks.recipe import ExpertRecipe

JOINTS = ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")
PITCH = 1  # in the state
LOWEST_PITCH = -0.75 * np.pi
"""Where one turn of pitch begins [rad]: head up and far over, which a cheetah only passes through. On its back it may
lie for long, and a picture cannot tell turns apart."""


def armature(value: float) -> tuple[Effect, ...]:
    """The same rotor inertia at all six driven joints [kg·m²]; the root's joints have none."""
    return tuple(JointArmature(joint, value) for joint in JOINTS)


def scale_total_mass(spec: mujoco.MjSpec, mass: float) -> None:
    """Give all geoms one density more or less, so that the model weighs ``mass`` [kg]."""
    spec.compiler.settotalmass = -1
    ratio = mass / spec.copy().compile().body_mass.sum()
    for geom in spec.geoms:
        geom.density *= ratio


class HalfCheetah(Locomotion):
    """State (17,), actions (6,): see :class:`Locomotion`. Reward: speed less 0.1 of the squared action; never ends.

    Pitch in the state is within one turn from :data:`LOWEST_PITCH`, in ``data.qpos`` it is not.
    """

    name = "half_cheetah"
    frame_skip = 5
    xml = "half_cheetah.xml"
    control_cost = 0.1
    expert = ExpertRecipe(steps=60_000)

    def base(self) -> mujoco.MjSpec:
        spec = super().base()
        scale_total_mass(spec, 14.0)  # what the model's own settotalmass asks for, which MuJoCo deprecates
        # A fast policy runs off Gymnasium's 40 m of floor, of which only the picture ends.
        spec.geom("floor").size = (400, 400, 40)
        spec.material("MatPlane").texrepeat = (600, 600)
        return spec

    def domains(self) -> dict[str, Domain]:
        camera = CameraFrame(CAMERA, position=(0, -3, 0.3), xyaxes=(1, 0, 0, 0, 0, 1))
        source = Domain("source", self.base, (camera, *armature(0.1)))
        easy = source.with_effects(
            *armature(0.18),
            Texture("sky", flat=(0.4, 0.4, 0.6)),
            Light("lamp", diffuse=(0.8, 1, 0.8)),
        )
        hard = source.with_effects(
            *armature(0.4),
            CameraFrame(CAMERA, position=(-0.7, -3, 0.3), xyaxes=(1, -0.2, 0, -0.2, 0, 1)),
            *DM_CONTROL_LOOK,
            *(Color(geom, (1, 0.7, 1, 1)) for geom in ("torso", "head", "bthigh", "fthigh")),
        )
        return {d.name: d for d in (source, easy.named("easy"), hard.named("hard"))}

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        state = super().state(model, data)
        state[PITCH] -= 2 * np.pi * np.floor((state[PITCH] - LOWEST_PITCH) / (2 * np.pi))
        return state

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        positions, velocities = super().motion(states, period)
        positions[:, 1 + PITCH] = np.unwrap(positions[:, 1 + PITCH])
        return positions, velocities

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        data.qpos[:] = model.qpos0 + rng.uniform(-0.1, 0.1, model.nq)
        data.qvel[:] = 0.1 * rng.standard_normal(model.nv)

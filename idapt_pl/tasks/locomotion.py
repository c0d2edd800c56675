"""Running forward in a vertical plane: what HalfCheetah and Walker2d share."""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect
from idapt_pl.effects.visual import CAMERA, Light, Material, Texture
from idapt_pl.tasks.task import Task


class Locomotion(Task):
    """State: positions without x, then velocities. Reward: forward speed, a bonus for each step, less a control cost.

    As Gymnasium's environments, with every action held for two of their steps, whose rewards are summed.
    ``data.userdata[0]`` is x before the last physics steps [m].

    Attributes:
        xml: Gymnasium's model.
        alive: reward of a step.
        control_cost: weight of the squared action.
        velocity_limit: velocities are clipped to it in the state vector, as Gymnasium does in some.
        direction: 1 pays for going forward, -1 for going backwards.
    """

    action_repeat = 2
    horizon = 500
    xml: ClassVar[str]
    alive: ClassVar[float] = 0.0
    control_cost: ClassVar[float]
    velocity_limit: ClassVar[float] = np.inf
    direction: float = 1.0
    # State: z, pitch, six joints; then the velocities of x, z, pitch, joints. Nothing here is x itself.
    rates: Mapping[int, int] = {9 + i: i for i in range(8)}
    unseen = ("rootx",)

    def base(self) -> mujoco.MjSpec:
        file = importlib.resources.files("gymnasium") / "envs/mujoco/assets" / self.xml
        spec = mujoco.MjSpec.from_string(file.read_text())
        spec.nuserdata = 1
        spec.lights[0].name = "lamp"
        spec.textures[0].name = "sky"
        for motor in spec.actuators:  # Walker2d's have no names, and effects need them
            motor.name = motor.name or motor.target
        spec.body("torso").add_camera(name=CAMERA, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM)
        return spec

    def play(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> None:
        data.userdata[0] = data.qpos[0]
        super().play(model, data, action)

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        return np.concatenate([data.qpos[1:], np.clip(data.qvel, -self.velocity_limit, self.velocity_limit)])

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        speed = states[:, 8]
        x = np.concatenate([[0.0], np.cumsum(speed[1:] + speed[:-1]) * period / 2])
        return np.column_stack([x, states[:, :8]]), states[:, 8:]

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        speed = (data.qpos[0] - data.userdata[0]) / (model.opt.timestep * self.frame_skip)
        reward = self.direction * speed + self.alive - self.control_cost * np.square(action).sum()
        return float(reward), not self.upright(data)

    def backwards(self) -> Locomotion:
        task = type(self)()
        task.direction = -1.0
        return task

    def upright(self, data: mujoco.MjData) -> bool:
        """Whether the episode goes on."""
        return bool(np.isfinite(data.qpos).all())


DM_CONTROL_LOOK: tuple[Effect, ...] = (
    Texture("sky", dm_control="skybox.xml"),
    Material("floor", dm_control="grid"),
    Light("lamp", (0.7, 0.7, 0.7), (0, 0, 0), (0.3, 0.3, 0.3), position=(0, 0, 1.5), kind="spot"),
)
"""Sky, floor and lamp of dm_control's suite, which the hard domains share."""

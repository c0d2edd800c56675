"""A pendulum in MuJoCo, for a policy that is to swing up Gymnasium's Pendulum-v1, whose Euler steps know no MuJoCo."""

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.visual import CAMERA, CameraPose
from idapt_pl.tasks import Task

MJCF = """
<mujoco><option timestep="0.01"/><visual><headlight ambient="0.5 0.5 0.5" diffuse="0.5 0.5 0.5"/></visual>
  <asset><texture type="skybox" builtin="flat" rgb1="0.35 0.4 0.5" width="8" height="8"/></asset>
  <worldbody><body name="rod"><joint name="hinge" axis="0 -1 0"/><geom name="rod" type="capsule"
    fromto="0 0 0 0 0 1" size="0.08" mass="0.7" rgba="0.2 0.7 0.3 1"/></body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2"/></actuator>
</mujoco>"""


class Pendulum(Task):
    """State: cosine and sine of the angle from upright, and its speed, rad/s. Reward and start as Pendulum-v1's."""

    frame_skip, horizon = 5, 200

    def base(self):
        spec = mujoco.MjSpec.from_string(MJCF)
        spec.worldbody.add_camera(name=CAMERA)
        CameraPose(CAMERA, azimuth=90, elevation=0, distance=5.3, lookat=(0, 0, 0)).apply(spec)
        return spec

    def domains(self):
        return {"source": Domain("source", self.base)}

    def reset(self, model, data, rng):
        data.qpos[:], data.qvel[:] = rng.uniform(-np.pi, np.pi), rng.uniform(-1, 1)

    def state(self, model, data):
        return np.concatenate([np.cos(data.qpos), np.sin(data.qpos), data.qvel])

    def motion(self, states, period):
        return np.unwrap(np.arctan2(states[:, 1:2], states[:, :1]), axis=0), states[:, 2:]

    def outcome(self, model, data, action):
        angle = np.arctan2(np.sin(data.qpos[0]), np.cos(data.qpos[0]))
        return -float(angle**2 + 0.1 * data.qvel[0] ** 2 + 0.001 * action[0] ** 2), False

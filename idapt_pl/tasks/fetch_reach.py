"""Fetch-Reach: move the gripper of a Fetch arm to a point (gymnasium-robotics' model; differences as in Table I)."""

from __future__ import annotations

import functools
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.acting import advance
from idapt_pl.effects.actuators import ActuatorBias, ActuatorRotation
from idapt_pl.effects.packaged import packaged_file
from idapt_pl.effects.visual import CAMERA, CameraFrame, CameraPose, Color, Light, Material
from idapt_pl.tasks.indoors import indoors
from idapt_pl.tasks.recipe import ExpertRecipe
from idapt_pl.tasks.task import Task

COMMANDS = ("x", "y", "z", "gripper")
HAND, GRIP = "robot0:gripper_link", "robot0:grip"
FINGERS = ("robot0:r_gripper_finger_joint", "robot0:l_gripper_finger_joint")
FETCH_POINTING_DOWN = np.array([1.0, 0.0, 1.0, 0.0])
GRIPPER_START = (1.342, 0.749, 0.535)
"""Where the gripper is when an episode starts, to the millimetre [m]; cameras look at it."""


class FetchReach(Task):
    """Actions (4,): displacements of the hand along x, y, z, of 0.05 m at most, and the gripper, which is blocked.

    State (16,): gripper (3) and goal (3) [m], then the observation of gymnasium-robotics: gripper (3) [m], fingers (2)
    [m], and the displacements of gripper (3) and fingers (2) in a control step [m]. Reward: minus the distance [m] from
    gripper to goal; success: it is below 0.05 m at any time. The goal lies up to 0.15 m from the gripper's start in x
    and y, at a height of 0.45 m.

    The hand is welded to a mocap body that a command moves relative to where the hand is. Actuators that exert nothing
    (their gear is 0) give the commands names and ranges, so that effects apply to them: what counts is
    ``data.actuator_force``, what comes out of an actuator.
    """

    name = "fetch_reach"
    metric = "success"
    frame_skip = 20
    horizon = 50
    expert = ExpertRecipe(steps=10_000, gamma=0.95)
    reach: ClassVar[float] = 0.05
    """Distance that counts as success [m]."""
    step_length: ClassVar[float] = 0.05
    """Displacement that a command of 1 asks for [m]."""

    def base(self) -> mujoco.MjSpec:
        spec = fetch_model()
        qpos, qvel = start_state()
        spec.add_key(name="start", qpos=qpos, qvel=qvel)
        spec.worldbody.add_camera(name=CAMERA)
        return spec

    def domains(self) -> dict[str, Domain]:
        def camera(azimuth: float, elevation: float, distance: float) -> CameraPose:
            return CameraPose(CAMERA, azimuth, elevation, distance, lookat=GRIPPER_START)

        source = Domain("source", self.base, (camera(180, -35, 1.0),))
        easy = source.with_effects(
            ActuatorRotation("x y", np.deg2rad(30)),
            camera(165, -35, 1.2),
            Material("floor0", dm_control="grid"),
            Color("table", (0.93, 0.93, 0.5, 1)),
            Light("lamp", (0.7, 0.7, 0.7), (0, 0, 0), (0.1, 0.1, 0.1)),
        )
        hard = source.with_effects(
            ActuatorRotation("x y", np.deg2rad(45)),
            ActuatorBias("z", -0.5),
            CameraFrame(CAMERA, position=(2.0, 0.6, 1.2), xyaxes=(0.2, 1, 0, -0.9, 0, 1)),
            *indoors(robot=(0.6, 0.75, 0)),
        )
        return {d.name: d for d in (source, easy.named("easy"), hard.named("hard"))}

    def reset(self, model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        start = data.site(GRIP).xpos
        goal = (*(start[:2] + rng.uniform(-0.15, 0.15, 2)), 0.45)
        data.mocap_pos[goal_index(model)] = goal

    def play(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> None:
        data.ctrl[:] = action
        mujoco.mj_fwdActuation(model, data)
        hand, mocap = data.body(HAND), int(model.body("robot0:mocap").mocapid[0])
        data.mocap_pos[mocap] = hand.xpos + self.step_length * data.actuator_force[:3]
        data.mocap_quat[mocap] = hand.xquat + FETCH_POINTING_DOWN  # MuJoCo normalises the sum
        advance(model, data, self.frame_skip)
        for finger in FINGERS:
            data.joint(finger).qpos = 0.0
        mujoco.mj_forward(model, data)

    def state(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        gripper, period = data.site(GRIP).xpos, self.period(model)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(GRIP).id, velocity, 0)
        fingers = [data.joint(f) for f in FINGERS]
        positions = [gripper, data.mocap_pos[goal_index(model)], gripper, *(f.qpos for f in fingers)]
        return np.concatenate([*positions, period * velocity[3:], *(period * f.qvel for f in fingers)])

    def outcome(self, model: mujoco.MjModel, data: mujoco.MjData, action: np.ndarray) -> tuple[float, bool]:
        return -self.distance(model, data), False

    def success(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        return self.distance(model, data) < self.reach

    def distance(self, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        """From the gripper to the goal [m]."""
        return float(np.linalg.norm(data.site(GRIP).xpos - data.mocap_pos[goal_index(model)]))


def goal_index(model: mujoco.MjModel) -> int:
    """The goal's row in ``data.mocap_pos``."""
    return int(model.body("goal").mocapid[0])


def fetch_model() -> mujoco.MjSpec:
    """The package's model, with a goal that each simulation can have elsewhere, and commands as actuators."""
    spec = mujoco.MjSpec.from_file(str(packaged_file("gymnasium-robotics", "envs/assets/fetch/reach.xml")))
    for geom in spec.body("robot0:mocap").geoms:  # a cross that shows where the hand is pulled
        geom.group = 4
    spec.delete(spec.body("floor0"))
    goal = spec.worldbody.add_body(name="goal", mocap=True)
    goal.add_geom(size=(0.045, 0, 0), rgba=(1, 0, 0, 1), contype=0, conaffinity=0)  # a sphere, as in the paper's video
    spec.light("light0").name = "lamp"
    spec.body("table0").geoms[0].name = "table"
    spec.equalities[0].data[3:10] = (0, 0, 0, 1, 0, 0, 0)  # the hand is where the mocap body is
    for name in COMMANDS:
        command = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target="robot0:slide0")
        command.gear = np.zeros(6)
        command.ctrlrange, command.ctrllimited = (-1, 1), mujoco.mjtLimited.mjLIMITED_FALSE
    return spec


@functools.cache
def start_state() -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities at the start: the hand has been pulled over the table for 0.4 s."""
    model = fetch_model().compile()
    data = mujoco.MjData(model)
    data.joint("robot0:slide0").qpos, data.joint("robot0:slide1").qpos = 0.4049, 0.48
    mujoco.mj_forward(model, data)
    mocap = int(model.body("robot0:mocap").mocapid[0])
    data.mocap_pos[mocap] = data.site(GRIP).xpos + np.array([-0.498, 0.005, -0.431 + 0.2])
    data.mocap_quat[mocap] = FETCH_POINTING_DOWN
    mujoco.mj_step(model, data, 10 * FetchReach.frame_skip)
    return data.qpos.copy(), data.qvel.copy()

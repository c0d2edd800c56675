"""A cart-pole in PyBullet, with its own physics and renderer: `pip install pybullet`. Nothing here is MuJoCo's."""

import tempfile

import gymnasium
import numpy as np
import pybullet

URDF = """
<robot name="cartpole">
  <link name="rail"><inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
    <visual><geometry><box size="30 0.03 0.03"/></geometry><material name="r"><color rgba="0.3 0.3 0.3 1"/></material>
    </visual></link>
  <link name="cart"><inertial><mass value="12"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><box size="0.35 0.2 0.15"/></geometry><material name="c"><color rgba="0.7 0.2 0.15 1"/></material>
    </visual></link>
  <link name="pole"><inertial><origin xyz="0 0 0.35"/><mass value="3"/>
      <inertia ixx="0.12" ixy="0" ixz="0" iyy="0.12" iyz="0" izz="0.01"/></inertial>
    <visual><origin xyz="0 0 0.35"/><geometry><box size="0.06 0.06 0.7"/></geometry>
      <material name="p"><color rgba="0.9 0.8 0.2 1"/></material></visual></link>
  <joint name="slide" type="prismatic"><axis xyz="1 0 0"/><parent link="rail"/><child link="cart"/>
    <limit effort="1000" lower="-15" upper="15" velocity="50"/></joint>
  <joint name="hinge" type="continuous"><axis xyz="0 1 0"/><origin xyz="0 0 0.05"/><parent link="cart"/>
    <child link="pole"/></joint>
</robot>"""


class BulletCartPole(gymnasium.Env):
    """Actions are forces on the cart, N; it is over when the pole leans by 0.2 rad. Rewards are for reports alone."""

    dt = 0.04

    def __init__(self, force=200.0, size=128):
        self.action_space = gymnasium.spaces.Box(-force, force, (1,), np.float32)
        self.observation_space = gymnasium.spaces.Box(0, 255, (size, size, 3), np.uint8)
        self.size, self.client = size, pybullet.connect(pybullet.DIRECT)
        with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
            file.write(URDF)
            file.flush()
            self.robot = pybullet.loadURDF(file.name, useFixedBase=True, physicsClientId=self.client)
        pybullet.setGravity(0, 0, -9.81, physicsClientId=self.client)
        pybullet.setTimeStep(0.005, physicsClientId=self.client)
        for joint in (0, 1):  # PyBullet brakes joints unless it is told not to
            pybullet.setJointMotorControl2(
                self.robot, joint, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=self.client
            )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        for joint, position in enumerate(self.np_random.uniform(-0.01, 0.01, 2)):
            pybullet.resetJointState(self.robot, joint, position, 0.0, physicsClientId=self.client)
        return self.picture(), {}

    def step(self, action):
        for _ in range(8):
            pybullet.setJointMotorControl2(
                self.robot, 0, pybullet.TORQUE_CONTROL, force=float(action[0]), physicsClientId=self.client
            )
            pybullet.stepSimulation(physicsClientId=self.client)
        over = abs(pybullet.getJointState(self.robot, 1, physicsClientId=self.client)[0]) > 0.2
        return self.picture(), float(not over), over, False, {}

    def picture(self):
        view = pybullet.computeViewMatrix([0, -2.6, 0.25], [0, 0, 0.25], [0, 0, 1])
        lens = pybullet.computeProjectionMatrixFOV(fov=30, aspect=1, nearVal=0.1, farVal=10)
        image = pybullet.getCameraImage(
            self.size, self.size, view, lens, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self.client
        )[2]
        return np.reshape(image, (self.size, self.size, 4))[..., :3].astype(np.uint8)

    def close(self):
        pybullet.disconnect(self.client)

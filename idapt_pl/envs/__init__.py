"""Image environments: a domain, a robot, the target as training may see it, and the grounded source."""

from idapt_pl.envs.action_map import ActionMap, MappedActions
from idapt_pl.envs.grounded_env import GroundedEnv
from idapt_pl.envs.image_env import VectorImageEnv
from idapt_pl.envs.kept_near import KeptNear
from idapt_pl.envs.robot_env import RobotEnv, TargetFailed
from idapt_pl.envs.seen_through import SeenThrough
from idapt_pl.envs.state_env import StatesOnly, VectorStateEnv
from idapt_pl.envs.target_env import BlindTarget, PixelsOnly
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper

__all__ = [
    "ActionMap",
    "BlindTarget",
    "GroundedEnv",
    "ImageEnv",
    "ImageEnvWrapper",
    "KeptNear",
    "MappedActions",
    "PixelsOnly",
    "RobotEnv",
    "SeenThrough",
    "StatesOnly",
    "TargetFailed",
    "VectorImageEnv",
    "VectorStateEnv",
]

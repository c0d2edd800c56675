"""What the wrappers of image environments share."""

from __future__ import annotations

from typing import TypeAlias

import gymnasium

from idapt_pl.envs.image_env import VectorImageEnv
from idapt_pl.envs.robot_env import RobotEnv


class ImageEnvWrapper(gymnasium.vector.VectorWrapper):
    """A wrapper that tells the control period of what it wraps; Gymnasium's own forward nothing but its interface.

    Args:
        env: the image environment, or another wrapper of one.
    """

    env: ImageEnv

    @property
    def dt(self) -> float:
        """Control period, s."""
        return self.env.dt


ImageEnv: TypeAlias = VectorImageEnv | RobotEnv | ImageEnvWrapper
"""Simulations of one domain that are stepped together, or one robot; wrapped or not."""

"""What the wrappers of image environments share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, TypeAlias

import gymnasium
import numpy as np

from idapt_pl.envs.image_env import Observations, ResetResult, StepResult, VectorImageEnv
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

    @property
    def own_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the actions that what is wrapped takes itself, (nu,) each."""
        if isinstance(self.env, ImageEnvWrapper):
            return self.env.own_bounds
        space = self.env.single_action_space
        assert isinstance(space, gymnasium.spaces.Box)  # as of all image environments
        return space.low, space.high


class ShownOtherwise(ImageEnvWrapper, ABC):
    """A wrapper that makes something else of every observation, the last ones of episodes included."""

    @abstractmethod
    def show(self, obs: Observations) -> Observations:
        """What is shown in place of an observation."""

    def reset(self, **kwargs: Any) -> ResetResult:
        obs, infos = self.env.reset(**kwargs)
        return self.show(obs), infos

    def step(self, actions: np.ndarray) -> StepResult:
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": self.show(infos["final_obs"])}
        return self.show(obs), rewards, terminations, truncations, infos


ImageEnv: TypeAlias = VectorImageEnv | RobotEnv | ImageEnvWrapper
"""Simulations of one domain that are stepped together, or one robot; wrapped or not."""

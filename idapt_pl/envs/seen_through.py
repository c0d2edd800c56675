"""An environment seen through something that reads its images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from idapt_pl.envs.image_env import Observations, ResetResult, StepResult
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper


class SeenThrough(ImageEnvWrapper):
    """Shows what is made of the images in place of ``pixels``; the images themselves are ``source_pixels``.

    Args:
        env: shows images.
        see: uint8 (n, K, H, W, 3) to what the policy sees of them, n rows.
    """

    def __init__(self, env: ImageEnv, see: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__(env)
        self.see = see

    def reset(self, **kwargs: Any) -> ResetResult:
        obs, infos = self.env.reset(**kwargs)
        return self._show(obs), infos

    def step(self, actions: np.ndarray) -> StepResult:
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": self._show(infos["final_obs"])}
        return self._show(obs), rewards, terminations, truncations, infos

    def _show(self, obs: Observations) -> Observations:
        return {**obs, "pixels": self.see(obs["pixels"]), "source_pixels": obs["pixels"]}

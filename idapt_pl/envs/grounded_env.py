"""The grounded environment: the source simulator seen through G and moved through F (Section IV-C)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from idapt_pl.envs.image_env import Observations, ResetResult, StepResult
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper

Translate = Callable[[np.ndarray], np.ndarray]
"""G: uint8 (n, k, H, W, 3) source frames to uint8 target-style frames of the same shape."""
TransformAction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""F: target observation pixels (n, K, H, W, 3) and target actions (n, nu) to source actions (n, nu)."""


class GroundedEnv(ImageEnvWrapper):
    """Source environment that looks and moves like the target.

    Each step: ô^T = G(o^S); the policy chooses a^T from ô^T; â^S = F(ô^T, a^T); the source steps with â^S.
    Reward and state are the source's; ``source_pixels`` in the observation is o^S. With G and F left out
    (identity) the source is reproduced bit for bit.

    Args:
        env: the source environment (or what is to be seen through G alone).
        G: visual transformation, or None for identity.
        F: action transformation, or None for identity.
        frames: how many frames G translates at a time: 1, or the whole stack K.
    """

    def __init__(
        self, env: ImageEnv, G: Translate | None = None, F: TransformAction | None = None, frames: int = 1
    ) -> None:
        super().__init__(env)
        self.G, self.F, self.frames = G, F, frames
        self._pixels = np.zeros(0, np.uint8)  # ô^T, (n, K, H, W, 3), once there is one

    def reset(self, **kwargs: Any) -> ResetResult:
        obs, infos = self.env.reset(**kwargs)
        if self._pixels.size == 0:
            self._pixels = np.zeros_like(obs["pixels"])
        self._pixels = self._translate(obs["pixels"], fresh=np.ones(self.num_envs, bool))
        return self._observe(obs, self._pixels.copy()), infos

    def step(self, actions: np.ndarray) -> StepResult:
        if self.F is not None:
            actions = self.F(self._pixels, actions)
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        done = terminations | truncations
        if done.any():
            final = self._translate(infos["final_obs"]["pixels"], fresh=np.zeros(self.num_envs, bool))
            infos = {**infos, "final_obs": self._observe(infos["final_obs"], final)}
        self._pixels = self._translate(obs["pixels"], fresh=done)
        return self._observe(obs, self._pixels.copy()), rewards, terminations, truncations, infos

    @staticmethod
    def _observe(obs: Observations, pixels: np.ndarray) -> Observations:
        return {**obs, "pixels": pixels, "source_pixels": obs["pixels"]}

    def _translate(self, pixels: np.ndarray, fresh: np.ndarray) -> np.ndarray:
        """G on what is new. ``fresh`` marks simulations just reset, whose stack is one repeated frame."""
        if self.G is None:
            return pixels
        if self.frames > 1:
            return self.G(pixels)
        newest = self.G(pixels[:, -1:])
        stack = np.concatenate([self._pixels[:, 1:], newest], axis=1)
        stack[fresh] = newest[fresh]
        return stack

"""The target as training may see it: images, actions, nothing else; and every interaction counted."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from idapt_pl.envs.image_env import ResetResult, StepResult
from idapt_pl.envs.ledger import Ledger
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper


class PixelsOnly(ImageEnvWrapper):
    """An environment without its states, whose meaning is its own."""

    def __init__(self, env: ImageEnv) -> None:
        super().__init__(env)
        one, several = env.single_observation_space, env.observation_space
        assert isinstance(one, gymnasium.spaces.Dict) and isinstance(several, gymnasium.spaces.Dict)
        self.single_observation_space = gymnasium.spaces.Dict({"pixels": one["pixels"]})
        self.observation_space = gymnasium.spaces.Dict({"pixels": several["pixels"]})

    def reset(self, **kwargs: Any) -> ResetResult:
        obs, infos = self.env.reset(**kwargs)
        return {"pixels": obs["pixels"]}, infos

    def step(self, actions: np.ndarray) -> StepResult:
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        if "final_obs" in infos:
            infos = {**infos, "final_obs": {"pixels": infos["final_obs"]["pixels"]}}
        return {"pixels": obs["pixels"]}, rewards, terminations, truncations, infos


class BlindTarget(PixelsOnly):
    """Hides the target's state and reward, and enters every step in the ledger.

    Rewards are NaN, so anything trained on them breaks visibly. That an episode has ended is visible, as
    it is on a robot that fell over; why it ended is not: every end is reported as a truncation.

    Args:
        env: the target.
        ledger: where interactions are counted.
        step: grounding step that they are for.
        purpose: what they are for; ``"training"`` counts as the method's.
    """

    def __init__(self, env: ImageEnv, ledger: Ledger, step: int, purpose: str) -> None:
        super().__init__(env)
        self._entry = (ledger, step, purpose)

    def reset(self, **kwargs: Any) -> ResetResult:
        obs, _ = self.env.reset(**kwargs)
        return {"pixels": obs["pixels"]}, {}

    def step(self, actions: np.ndarray) -> StepResult:
        obs, _, terminations, truncations, infos = self.env.step(actions)
        ledger, step, purpose = self._entry
        ledger.count(step, purpose, self.num_envs)
        seen = {}
        if "final_obs" in infos:
            seen = {"final_obs": {"pixels": infos["final_obs"]["pixels"]}, "_final_obs": infos["_final_obs"]}
        ended = terminations | truncations
        return {"pixels": obs["pixels"]}, np.full(self.num_envs, np.nan), np.zeros_like(ended), ended, seen

"""A training environment whose rewards are less where nobody has been."""

from __future__ import annotations

import numpy as np

from idapt_pl.envs.image_env import StepResult
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper


class KeptNear(ImageEnvWrapper):
    """Takes ``cost`` · (1 - exp(-m²/2)) off the reward, m the Mahalanobis distance of the state from familiar ones.

    What is read of images is wrong where G and the encoder have seen nothing like them. A policy that sees true states
    does not know, and may end its way there.

    Args:
        env: with states and rewards.
        familiar: states, (n, state_dim).
        cost: where nothing is familiar.
    """

    def __init__(self, env: ImageEnv, familiar: np.ndarray, cost: float) -> None:
        super().__init__(env)
        self.cost, self.mean = cost, familiar.mean(0)
        self.precision = np.linalg.pinv(np.atleast_2d(np.cov(familiar.T)), hermitian=True)

    def step(self, actions: np.ndarray) -> StepResult:
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        off = infos.get("final_obs", obs)["state"] - self.mean
        distance = np.einsum("ni,ij,nj->n", off, self.precision, off)
        return obs, rewards - self.cost * (1 - np.exp(-0.5 * distance)), terminations, truncations, infos

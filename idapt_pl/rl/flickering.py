"""A policy acting on estimates with the noise from image to image that it trains with."""

from __future__ import annotations

import numpy as np
import torch

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import Acting


class FlickeringPolicy(Acting):
    """A policy acting with its mean, on estimates that :class:`.Flicker` has been upon.

    Args:
        module: the policy.
        num_envs: simulations it acts in.
        seed: of the noise.
    """

    def __init__(self, module: AsymmetricSAC, num_envs: int, seed: int) -> None:
        super().__init__(module, deterministic=True)
        self.noise = module.flicker(num_envs, seed)

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions for what an environment gives as ``pixels``; they are taken to be played."""
        features = self.module.encode(pixels)
        seen = self.noise({"observation": features.cpu().numpy()})["observation"]
        actions = self.on_features(torch.from_numpy(seen).to(features.device))
        self.played(actions)
        return actions.cpu().numpy()

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; new episodes begin with an image that stands for those before it."""
        super().tick(ended)
        self.noise.renew(ended)

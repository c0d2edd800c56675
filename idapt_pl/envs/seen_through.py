"""An environment seen through something that reads its images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from idapt_pl.envs.image_env import Observations
from idapt_pl.envs.wrapper import ImageEnv, ShownOtherwise


class SeenThrough(ShownOtherwise):
    """Shows what is made of the images in place of ``pixels``; the images themselves are ``source_pixels``.

    Args:
        env: shows images.
        see: uint8 (n, K, H, W, 3) to what the policy sees of them, n rows.
    """

    def __init__(self, env: ImageEnv, see: Callable[[np.ndarray], np.ndarray]) -> None:
        super().__init__(env)
        self.see = see

    def show(self, obs: Observations) -> Observations:
        return {**obs, "pixels": self.see(obs["pixels"]), "source_pixels": obs["pixels"]}

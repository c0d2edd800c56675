"""What a teacher earns while it sees states as wrongly as it does in training."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv

from idapt_pl.modules import StateSAC
from idapt_pl.rl.returns import evaluate


class MisledTeacher:
    """A teacher acting with its mean on states with the errors that it trains with.

    Args:
        teacher: SAC on states.
        num_envs: simulations it acts in.
        seed: of the errors.
    """

    def __init__(self, teacher: StateSAC, num_envs: int, seed: int) -> None:
        self.teacher, self.noise = teacher, teacher.observation_noise(num_envs, seed)

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu) for true states (n, s), which stand for ``pixels`` where nothing is rendered."""
        seen = self.noise(self.teacher.remember(pixels))
        return self.teacher.act(seen["observation"], deterministic=True)

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; in new episodes the errors are others."""
        if ended.any():
            self.noise.renew(ended)


def noisy_return(teacher: StateSAC, env: VectorEnv, episodes: int, seed: int) -> float:
    """Mean return (or success) of whole episodes of a misled teacher."""
    return evaluate(env, MisledTeacher(teacher, env.num_envs, seed), episodes, seed).mean

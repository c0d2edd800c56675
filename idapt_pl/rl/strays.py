"""Random actions now and then, after which whoever learns sees the way back."""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv


class Strays:
    """Puts random actions, uniform within bounds and held for some steps each, in the place of others.

    Args:
        env: whose actions they are.
        share: of the steps.
        seed: of when and what.
    """

    LONGEST = 8
    """Control steps for which one is held at most."""

    def __init__(self, env: VectorEnv, share: float, seed: int) -> None:
        space = env.action_space
        assert isinstance(space, Box)  # actions are continuous
        self._low, self._high = space.low, space.high
        self._rng = np.random.default_rng([seed, 1])
        self._left, self._held = np.zeros(env.num_envs, int), np.zeros_like(space.low)
        self._often = share / (share + (1 - share) * (1 + self.LONGEST) / 2)  # that one begins where none goes on

    def __call__(self, actions: np.ndarray) -> np.ndarray:
        """Actions (n, nu), some of them others."""
        begins = (self._left == 0) & (self._rng.random(len(actions)) < self._often)
        self._left[begins] = self._rng.integers(1, self.LONGEST + 1, int(begins.sum()))
        self._held[begins] = self._rng.uniform(self._low, self._high)[begins]
        strayed = self._left > 0
        self._left[strayed] -= 1
        return np.where(strayed[:, None], self._held, actions)

"""Exploration by what a teacher does in the source, played without looking."""

from __future__ import annotations

import numpy as np

from idapt_pl.modules import StateSAC
from idapt_pl.rollout import VectorEnv


class Rehearsal:
    """An ``Act`` that plays a teacher's actions open loop: those it takes in a source of its own, running alongside.

    Both begin their episodes together, and nothing that the robot does changes what is played. So both domains are
    shown the motions that the policy will make, for as long as they last without feedback, where random actions would
    show how the robot falls. What the source lacks moves the target's away from the source's.

    Args:
        teacher: sees states; its actions are drawn, as in its training.
        env: the source, with states, one simulation for each that is acted in.
        seed: of its resets.
    """

    def __init__(self, teacher: StateSAC, env: VectorEnv, seed: int) -> None:
        self.teacher, self.env = teacher, env
        self._actions = teacher.act(env.reset(seed=seed)[0]["state"])

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu) for now, whatever there is to see."""
        return self._actions

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says which simulations begin anew."""
        obs = self.env.step(self._actions)[0]
        if ended.any():
            obs = self.env.reset(options={"reset_mask": ended})[0]
        self._actions = self.teacher.act(obs["state"])

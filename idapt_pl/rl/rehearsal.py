"""Acting in the source so that what reads states learns from the motions that it will see."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.policy import Acting

STRONGEST_NOISE = 0.3
"""Largest spread of the noise on actions, as a share of half their range."""


class Rehearsal:
    """Acts as a teacher on true states, or as the policy on what it sees; every episode with noise of its own strength.

    Noise brings about states around the teacher's, and the policy those that its own errors lead to.

    Args:
        env: the source, whose states the teacher sees.
        teacher: chooses, or says in what units noise is.
        seed: of the noise.
        policy: acts in place of the teacher.
    """

    def __init__(self, env: VectorImageEnv, teacher: StateSAC, seed: int, policy: Acting | None = None) -> None:
        self.env, self.teacher, self.policy = env, teacher, policy
        self._rng = np.random.default_rng(seed)
        self._level = self._rng.uniform(0, STRONGEST_NOISE, env.num_envs)

    @torch.no_grad()
    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu), in the actuators' units."""
        head = self.teacher.actor
        low, high = head.center - head.half_range, head.center + head.half_range
        noise = torch.from_numpy(self._rng.normal(size=(len(pixels), len(low))) * self._level[:, None]).float()
        actions = (self.chosen(pixels) + noise.to(low.device) * head.half_range).clamp(low, high)
        if self.policy is not None:
            self.policy.played(actions)
        return actions.cpu().numpy()

    def chosen(self, pixels: np.ndarray) -> Tensor:
        """Mean actions (n, nu), before noise."""
        if self.policy is not None:
            return self.policy.on_features(self.policy.module.encode(pixels))
        return self.teacher.actor(self.teacher.encode(self.env.states()), deterministic=True)[0]

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says in which simulations it ended the episode."""
        self._level[ended] = self._rng.uniform(0, STRONGEST_NOISE, int(ended.sum()))
        if self.policy is not None:
            self.policy.tick(ended)

"""DAgger (Ross et al. 2011): a student is told what its teacher would have done where it has come itself."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from idapt_pl.modules import AsymmetricSAC, StateSAC
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.strays import Strays


class DaggerExperience(Experience):
    """Acts as teacher or student, step by step by chance, and says what the teacher would have done.

    Args:
        env: shows the student images, and has the source's states.
        student: remembers its observations as it does for SAC.
        teacher: looks at the true states.
        seed: of resets and of who acts.
        fading: calls over which the teacher's share falls from 1 to 0.
        images: give images and states too, for the estimator.
        strays: share of the steps in which neither acts.
    """

    def __init__(
        self, env: VectorEnv, student: AsymmetricSAC, teacher: StateSAC, seed: int, fading: int, images: bool,
        strays: float = 0.0,
    ) -> None:  # fmt: skip
        super().__init__(env, student, seed)
        self.teacher, self.share, self._fading = teacher, 1.0, fading
        self._kept = ("observation", "pixels", "state") if images else ("observation",)
        self._rng = np.random.default_rng(seed)
        self._strays = Strays(env, strays, seed)
        self.act = self._act

    def __call__(self) -> dict[str, np.ndarray]:
        """One step of every simulation: ``observation`` and, for it, what :func:`teacher_labels` says."""
        labels = teacher_labels(self.teacher, self._state)
        transitions = super().__call__()
        self.share = max(0.0, self.share - 1 / self._fading)
        return {k: transitions[k] for k in self._kept} | labels

    def _act(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        actions = self.policy.act_on(seen)
        taught = self._rng.random(len(actions)) < self.share
        actions[taught] = self.teacher.act(self._state)[taught]
        return self._strays(actions)


@torch.no_grad()
def teacher_labels(teacher: StateSAC, states: np.ndarray) -> dict[str, np.ndarray]:
    """The teacher's mean action on states (n, s), in -1..1, and the log of its spread before tanh; both (n, nu)."""
    mean, log_std = teacher.actor.gaussian(teacher.encode(states))
    return {"label": mean.tanh().cpu().numpy(), "label_log_std": log_std.cpu().numpy()}

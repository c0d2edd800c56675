"""Stepping an environment for the replay of a recurrent policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from idapt_pl.modules import RecurrentSAC
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.exploration import random_policy


class RecurrentExperience(Experience):
    """As :class:`.Experience`; every transition comes with what actor and critics knew before it.

    Args:
        env: with states and rewards.
        policy: acts, and decides what is remembered.
        seed: of the resets.
        random: act at random instead (warm-up of a new policy); memories go on all the same.
    """

    policy: RecurrentSAC

    def __init__(self, env: VectorEnv, policy: RecurrentSAC, seed: int, random: bool = False) -> None:
        super().__init__(env, policy, seed)
        self._draw = random_policy(env, seed) if random else None
        self._knows = {name: policy.begin(env.num_envs) for name in ("actor_memory", "critic_memory")}
        self.act = self._act

    def __call__(self) -> dict[str, np.ndarray]:
        """One step of every simulation: as of :class:`.Experience`, with what is ``REMEMBERED``."""
        before: dict[str, Any] = {name: m.hidden.cpu().numpy().copy() for name, m in self._knows.items()}
        before["before"] = self._knows["actor_memory"].action.cpu().numpy().copy()
        transitions = super().__call__()
        for memory in self._knows.values():
            memory.forget(torch.from_numpy(self.ended).to(memory.hidden.device))
        return transitions | before | {"ended": self.ended}

    def itself(self) -> RecurrentExperience:
        """The same, acting as the policy from now on; episodes go on, so that stretches may lie across."""
        self._draw = None
        return self

    @torch.no_grad()
    def _act(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        policy, state = self.policy, torch.from_numpy(self._state).to(self.policy.device)
        known = policy.remembering(policy.features_of(seen), self._knows["actor_memory"])
        policy.critic.recurrence.step(state, self._knows["critic_memory"])
        actions = policy.actor(known)[0].cpu().numpy() if self._draw is None else self._draw(seen["observation"])
        for memory in self._knows.values():
            memory.action = policy.actor.normalise(torch.from_numpy(actions).to(policy.device))
        return actions

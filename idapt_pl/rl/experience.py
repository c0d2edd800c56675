"""Stepping an environment for replay."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from gymnasium.vector import VectorEnv

from idapt_pl.modules import SAC
from idapt_pl.rl.exploration import random_policy


class Experience:
    """Steps an environment once a call and returns the n transitions, for replay.

    The successor of a finished episode is its last observation, not the first of the next one.

    Args:
        env: with states and rewards.
        policy: decides what is remembered of images, and acts on it.
        seed: of the resets.
        random: act at random instead (warm-up of a new policy).
    """

    def __init__(self, env: VectorEnv, policy: SAC, seed: int, random: bool = False) -> None:
        self.env, self.policy = env, policy
        self.act: Callable[[dict[str, np.ndarray]], np.ndarray] = policy.act_on
        if random:
            draw = random_policy(env, seed)
            self.act = lambda seen: draw(seen["observation"])
        obs, _ = env.reset(seed=seed)
        self.noise = policy.observation_noise(env.num_envs, seed)
        self._state, self._seen = obs["state"], self.noise(policy.remember(obs["pixels"]))
        self._return = np.zeros(env.num_envs)
        self._finished: deque[float] = deque(maxlen=20)

    def __call__(self) -> dict[str, np.ndarray]:
        """One step of every simulation: ``observation, state, actions, rewards, terminations, next_*``."""
        state, seen = self._state, self._seen
        actions = self.act(seen)
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        self.ended = done = terminations | truncations
        last = infos.get("final_obs", obs)
        next_state, next_seen = last["state"], self.noise(self.policy.remember(last["pixels"]))
        self._state, self._seen = obs["state"], next_seen
        if done.any():
            self.noise.renew(done)
            begun = self.noise(self.policy.remember(obs["pixels"]), done)
            self._seen = {k: rows_from(done, begun[k], seen) for k, seen in next_seen.items()}
        self._return += rewards
        self._finished.extend(self._return[done])
        self._return[done] = 0.0
        return {
            **seen,
            "state": state,
            "actions": actions,
            "rewards": rewards.astype(np.float32),
            "terminations": terminations,
            "next_observation": next_seen["observation"],
            "next_state": next_state,
        }

    @property
    def recent_return(self) -> float:
        """Mean return of the last 20 finished episodes; of the running ones before any has finished."""
        return float(np.mean(self._finished or self._return))


def rows_from(which: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    """Rows of ``new`` where ``which``, bool (n,), says so, and else of ``old``."""
    return np.where(which.reshape(-1, *[1] * (old.ndim - 1)), new, old)

"""Returns of whole episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gymnasium.vector import VectorEnv

from idapt_pl.rl.policy import Policy, tick


@dataclass(frozen=True)
class Returns:
    """Undiscounted returns of whole episodes; ``interactions`` is what they cost.

    ``successes`` says for each episode whether its goal was reached at any time, for tasks whose metric is success;
    the mean and spread are then of that, else of the returns.
    """

    returns: tuple[float, ...]
    interactions: int
    successes: tuple[bool, ...] = ()

    @property
    def mean(self) -> float:
        return float(np.mean(self.successes or self.returns))

    def to_dict(self) -> dict:
        """For JSON."""
        values = {"returns": list(self.returns), "successes": list(self.successes)}
        return {"mean": self.mean, "std": self.std, **values, "interactions": self.interactions}

    @property
    def std(self) -> float:
        return float(np.std(self.successes or self.returns))


def evaluate(
    env: VectorEnv, act: Policy, episodes: int, seed: int, watch: Callable[[dict[str, np.ndarray]], None] | None = None
) -> Returns:
    """Returns of ``episodes`` whole episodes, played ``env.num_envs`` at a time.

    Given a target with its reward it reads that; nothing that trains or selects has such a one. ``watch`` is shown what
    the environment showed, each time after the policy has acted on it.
    """
    returns: list[float] = []
    successes: list[bool] = []
    interactions = 0
    while len(returns) < episodes:
        obs, _ = env.reset(seed=seed + len(returns))
        playing = np.arange(env.num_envs) < episodes - len(returns)
        total, reached = np.zeros(env.num_envs), np.zeros(env.num_envs, bool)
        chosen = playing.copy()
        while playing.any():
            actions = act(obs["pixels"])
            if watch is not None:
                watch(obs)
            obs, rewards, terminations, truncations, infos = env.step(actions)
            total += rewards * playing
            reached |= infos.get("success", reached) & playing
            interactions += int(playing.sum())
            ended = terminations | truncations
            playing &= ~ended
            tick(act, ended if playing.any() else np.ones_like(ended))  # all begin anew with the next reset
        returns.extend(total[chosen])
        if "success" in infos:
            successes.extend(reached[chosen])
    return Returns(tuple(map(float, returns)), interactions, tuple(map(bool, successes)))

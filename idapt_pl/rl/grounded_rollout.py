"""Rollouts of the grounded source that GARAT learns from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from torch import Tensor

from idapt_pl.modules import ActionTransformation
from idapt_pl.rl.policy import Policy, tick


def garat_rollout(
    env: VectorEnv,
    policy: Callable[[Tensor], Tensor],
    F: ActionTransformation,
    length: int,
    seed: int,
    explore: Policy | None = None,
    exploring: int = 0,
) -> Callable[[], dict[str, Tensor]]:
    """A function that rolls the current F out for ``length`` steps of each simulation.

    ``env`` is the source seen through G; ``policy`` turns the features that F sees, f_π, into actions; F samples its
    residual and the source steps with the result. The first ``exploring`` simulations take the actions of
    ``explore`` instead, as the task-agnostic target data did.

    Returns:
        Tensors of shape (length, n, ...): ``features``, ``actions`` (the policy's), ``delta`` (F's sample),
        ``next_features``, ``next_actions``, ``ends`` (bool; the next row is another episode).
    """
    obs, _ = env.reset(seed=seed)
    device = F.device

    def choose(features: Tensor, pixels: np.ndarray) -> Tensor:
        actions = policy(features)
        if exploring:
            assert explore is not None  # given where some explore
            actions[:exploring] = torch.from_numpy(explore(pixels)[:exploring]).to(device)
        return actions

    @torch.no_grad()
    def roll() -> dict[str, Tensor]:
        nonlocal obs
        rows: list[dict[str, Tensor]] = []
        features = F.encode(obs["pixels"])
        actions = choose(features, obs["pixels"])
        for t in range(length):
            delta = F.residual(F.agent_input(features, actions)).sample()
            obs, _, terminations, truncations, infos = env.step(F.apply_residual(actions, delta).cpu().numpy())
            successor, done = infos.get("final_obs", obs), terminations | truncations
            tick(explore, done)
            row = {"features": features, "actions": actions, "delta": delta}
            row["next_features"] = features = F.encode(successor["pixels"])
            row["next_actions"] = actions = choose(features, successor["pixels"])
            row["ends"] = torch.from_numpy(done | (t == length - 1)).to(device)
            rows.append(row)
            if done.any():
                features, actions = features.clone(), actions.clone()
                features[done] = F.encode(obs["pixels"][done])
                actions[done] = choose(features, obs["pixels"])[done]
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    return roll

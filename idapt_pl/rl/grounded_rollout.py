"""Rollouts of the grounded source that GARAT learns from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from torch import Tensor

from idapt_pl.modules import ActionTransformation
from idapt_pl.rl.exploration import look_into
from idapt_pl.rl.policy import Policy, tick


class FeaturePolicy(Protocol):
    """A policy on the features that F sees (:class:`~idapt_pl.rl.policy.Acting`)."""

    def on_features(self, features: Tensor, only: Tensor | None = None) -> Tensor:
        """Actions (n, nu) for features (n, d); with ``only``, bool (n,), nothing new is remembered of the others."""

    def played(self, actions: Tensor) -> None:
        """The actions (n, nu) that were played."""

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says in which simulations it ended the episode."""


def garat_rollout(
    env: VectorEnv,
    policy: FeaturePolicy,
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
    look_into(explore, env)
    obs, _ = env.reset(seed=seed)
    device = F.device

    def choose(features: Tensor, pixels: np.ndarray, only: Tensor | None = None) -> Tensor:
        actions = policy.on_features(features, only)
        if exploring:
            assert explore is not None  # given where some explore
            actions[:exploring] = torch.from_numpy(explore(pixels)[:exploring]).to(device)
        return actions

    known = False  # whether the policy has seen the present features already

    @torch.no_grad()
    def roll() -> dict[str, Tensor]:
        nonlocal obs, known
        rows: list[dict[str, Tensor]] = []
        features = F.encode(obs["pixels"])
        actions = choose(features, obs["pixels"], torch.zeros(len(features), dtype=torch.bool) if known else None)
        known = True
        for t in range(length):
            policy.played(actions)
            delta = F.residual(F.agent_input(features, actions)).sample()
            obs, _, terminations, truncations, infos = env.step(F.apply_residual(actions, delta).cpu().numpy())
            successor, done = infos.get("final_obs", obs), terminations | truncations
            tick(explore, done)
            row = {"features": features, "actions": actions, "delta": delta}
            row["next_features"] = features = F.encode(successor["pixels"])
            row["next_actions"] = actions = choose(features, successor["pixels"])
            row["ends"] = torch.from_numpy(done | (t == length - 1)).to(device)
            rows.append(row)
            policy.tick(done)
            if done.any():
                features, actions = features.clone(), actions.clone()
                features[done] = F.encode(obs["pixels"][done])
                actions[done] = choose(features, obs["pixels"], torch.from_numpy(done).to(device))[done]
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    return roll

"""Policies that see states: experts and backwards ones for datasets, and the bounds of transfer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from datamodules import ReplayBuffer, ReplayDataModule
from idapt_pl.effects import Domain
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.returns import Returns, evaluate
from idapt_pl.stage import Stages
from idapt_pl.tasks import Task
from idapt_pl.tasks.recipe import ExpertRecipe


def train_expert(task: Task, domain: Domain, recipe: ExpertRecipe, stages: Stages, name: str) -> StateSAC:
    """SAC on states in one domain; a policy that is in the stages' folder is loaded instead."""
    env = VectorStateEnv(task, domain, recipe.num_envs)
    low, high = (bound.tolist() for bound in (env.single_action_space.low, env.single_action_space.high))
    with closing(env):
        build = lambda: StateSAC(env.state_dim, low, high, gamma=recipe.gamma)  # noqa: E731
        return fit_expert(build, lambda device: env, recipe, stages, 0, name)


def fit_expert(
    build: Callable[[], StateSAC],
    make_env: Callable[[torch.device], VectorEnv],
    recipe: ExpertRecipe,
    stages: Stages,
    step: int,
    name: str,
    fresh: bool = True,
    errors: Callable[[], Sequence[np.ndarray]] = tuple,
) -> StateSAC:
    """SAC on states in an environment whose ``pixels`` are its states, as one stage.

    A policy that is not ``fresh`` goes on from what it knows: it warms up with its own actions and keeps its scale.
    ``errors``, (T, s) of whole episodes, are what its actor has to bear meanwhile (:class:`.RecordedErrors`).
    """

    def feed(module: StateSAC, seed: int, device: torch.device) -> ReplayDataModule:
        env, module.recorded_errors = make_env(device), errors()
        buffer = ReplayBuffer(recipe.warmup_steps + recipe.steps + recipe.num_envs, seed)
        warm_up = Experience(env, module, seed, random=fresh)
        for _ in range(math.ceil(recipe.warmup_steps / recipe.num_envs)):
            buffer.add(warm_up())
        if fresh:
            module.actor.encoder.fit(buffer.sample(buffer.size, names=("state",))["state"].to(device))
        updates = round(recipe.updates_per_step * recipe.num_envs)
        act = Experience(env, module, seed + 1)
        return ReplayDataModule(act, buffer, recipe.batch, updates, recipe.steps // recipe.num_envs)

    expert = stages.fit(step, name, build, feed, recipe.steps // recipe.num_envs)
    expert.recorded_errors = ()
    return expert


def measure_expert(policy: StateSAC, task: Task, domain: Domain, episodes: int, seed: int) -> Returns:
    """What a policy reaches in a domain, acting with its mean on the true states."""
    with closing(VectorStateEnv(task, domain, min(episodes, 20))) as env:
        return evaluate(env, lambda states: policy.act(states, deterministic=True), episodes, seed)

"""Environments for what trains on states: experts, teachers and bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector.utils import batch_space

from idapt_pl.effects import Domain
from idapt_pl.envs.image_env import Observations, VectorImageEnv
from idapt_pl.envs.wrapper import ShownOtherwise
from idapt_pl.rendering.parallel import BatchRenderer
from idapt_pl.tasks import Task


class BlackImages:
    """Stands in for a renderer where nobody looks: frames are black."""

    def __init__(self, size: int) -> None:
        self.size = size

    def __call__(self, data: Sequence[mujoco.MjData]) -> np.ndarray:
        """Frames uint8 (n, size, size, 3)."""
        return np.zeros((len(data), self.size, self.size, 3), np.uint8)

    def close(self) -> None:
        """Nothing was opened."""


class VectorStateEnv(VectorImageEnv):
    """As :class:`VectorImageEnv`, but nothing is rendered: ``pixels`` is the state, float32 (n, state_dim), again.

    So what collects, evaluates and feeds SAC takes it as it is.

    Args:
        task: the task.
        domain: the world it is played in.
        num_envs: number of simulations.
        variants: as of :class:`VectorImageEnv`.
        horizon: likewise.
    """

    def __init__(
        self, task: Task, domain: Domain, num_envs: int = 1, variants: Sequence[Domain] = (), horizon: int = 0
    ) -> None:
        super().__init__(task, domain, num_envs, image_size=1, frame_stack=1, variants=variants, horizon=horizon)
        states = self.single_observation_space["state"]
        self.single_observation_space = gymnasium.spaces.Dict({"pixels": states, "state": states})
        self.observation_space = cast(gymnasium.spaces.Dict, batch_space(self.single_observation_space, num_envs))

    def _make_renderer(self, size: int, processes: int) -> BatchRenderer:
        return BlackImages(size)

    def _look(self) -> None:
        """There is nothing to see."""

    def _observe(self) -> Observations:
        states = super()._observe()["state"]
        return {"pixels": states, "state": states}


class StatesOnly(ShownOtherwise):
    """An environment that goes on rendering for itself but shows its states in place of ``pixels``.

    What trains on states so trains in the grounded source, whose F needs the images.
    """

    def show(self, obs: Observations) -> Observations:
        return {"pixels": obs["state"], "state": obs["state"]}

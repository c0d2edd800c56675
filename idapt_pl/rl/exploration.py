"""Policies that collect the first data: random, babbling, and a teacher's actions replayed open loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv

from idapt_pl.modules import StateSAC
from idapt_pl.rl.policy import Policy


def _bounds(env: VectorEnv) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of the actions of all simulations, (n, nu) each."""
    space = env.action_space
    assert isinstance(space, Box)  # actions are continuous
    return space.low, space.high


def random_policy(env: VectorEnv, seed: int) -> Policy:
    """Uniform actions within the bounds."""
    rng = np.random.default_rng(seed)
    low, high = _bounds(env)
    return lambda pixels: rng.uniform(low, high).astype(np.float32)


def babbling_policy(env: VectorEnv, seed: int) -> Policy:
    """Motor babbling: uniform actions around an offset, both redrawn with their amplitude now and then.

    Plain uniform actions at full strength shake a system so hard that slow motion is never seen.
    """
    rng = np.random.default_rng(seed)
    low, high = _bounds(env)
    center, half_range = (high + low) / 2, (high - low) / 2
    amplitude, offset = np.zeros((2, *low.shape))

    def act(pixels: np.ndarray) -> np.ndarray:
        redraw = rng.random(len(low)) < 0.1
        amplitude[redraw] = rng.random((int(redraw.sum()), 1)) ** 2
        offset[redraw] = rng.uniform(-1, 1, offset[redraw].shape) * amplitude[redraw]
        noise = rng.uniform(-1, 1, low.shape)
        return np.clip(center + half_range * (offset + amplitude * noise), low, high).astype(np.float32)

    return act


EXPLORATION: dict[str, Callable[[VectorEnv, int], Policy]] = {"random": random_policy, "babble": babbling_policy}
"""Task-agnostic policies, by the names configs and the command line use."""


class OpenLoopReplay:
    """A policy that plays a teacher's actions open loop: those it takes in a source of its own, running alongside.

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

"""Policies that collect the first data: random, babbling, experts, a teacher's actions replayed open loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv

from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.policy import Policy, tick
from idapt_pl.rl.strays import Strays


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


@runtime_checkable
class Onlooker(Policy, Protocol):
    """A policy that looks at the simulations themselves, whatever they show: a person at the controls."""

    def look_into(self, env: VectorEnv) -> None:
        """Look at what is played from now on."""


def look_into(policy: Policy | None, env: VectorEnv) -> None:
    """Let a policy that looks at simulations see those of an environment."""
    if isinstance(policy, Onlooker):
        policy.look_into(env)


class ExpertAtTheControls:
    """An expert, which acts on the true states of the simulations that are played; its actions are drawn.

    In a target too. What is recorded there holds images and actions all the same, and nothing that learns sees more.

    Args:
        expert: on states, trained in the source.
        name: of the exploration, for errors.
    """

    def __init__(self, expert: StateSAC, name: str) -> None:
        self.expert, self.name = expert, name
        self._env: VectorImageEnv | None = None

    def look_into(self, env: VectorEnv) -> None:
        """Look at what is played from now on.

        Raises:
            ValueError: if that is no simulation.
        """
        if not isinstance(simulations := env.unwrapped, VectorImageEnv):
            raise ValueError(
                f"schedule.exploration: {self.name} acts on true states, and what is played is no simulation with them"
            )
        self._env = simulations

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu) for the states of now, whatever the images show."""
        if self._env is None:
            raise ValueError(
                f"schedule.exploration: {self.name} acts on true states, and there is nothing to look into"
            )
        return self.expert.act(self._env.states())


class TakingTurns:
    """Several policies; an episode is played by the one that has played the fewest steps so far.

    Args:
        policies: they take turns in this order.
        num_envs: simulations that are acted in.
    """

    def __init__(self, policies: Sequence[Policy], num_envs: int) -> None:
        self.policies, self._turn = policies, np.zeros(num_envs, int)
        self._steps = np.zeros(len(policies), int)

    def look_into(self, env: VectorEnv) -> None:
        """Let those see it that look at simulations."""
        for policy in self.policies:
            look_into(policy, env)

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu) of whoever's turn it is in each simulation."""
        actions = np.stack([policy(pixels) for policy in self.policies])
        return actions[self._turn, np.arange(len(self._turn))]

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says in which simulations it ended the episode."""
        self._steps += np.bincount(self._turn, minlength=len(self._steps))
        for policy in self.policies:
            tick(policy, ended)
        for i in np.flatnonzero(ended):
            self._turn[i] = int(np.argmin(self._steps))


class OpenLoopReplay:
    """A policy that plays a teacher's actions open loop: those it takes in a source of its own, running alongside.

    Both begin their episodes together, and nothing that the robot does changes what is played. So both domains are
    shown the motions that the policy will make, for as long as they last without feedback, where random actions would
    show how the robot falls. What the source lacks moves the target's away from the source's.

    Args:
        teacher: sees states; its actions are drawn, as in its training.
        env: the source, with states, one simulation for each that is acted in.
        seed: of its resets.
        strays: share of the steps in which random actions are played in place of the teacher's, which then sees the
            way back. One gait alone is a curve through all poses, and a translation that takes the source's curve
            to the target's need not keep any pose.
    """

    def __init__(self, teacher: StateSAC, env: VectorEnv, seed: int, strays: float = 0.0) -> None:
        self.teacher, self.env, self._strayed = teacher, env, Strays(env, strays, seed)
        self._actions = self._strayed(teacher.act(env.reset(seed=seed)[0]["state"]))

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions (n, nu) for now, whatever there is to see."""
        return self._actions

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says which simulations begin anew."""
        obs = self.env.step(self._actions)[0]
        if ended.any():
            obs = self.env.reset(options={"reset_mask": ended})[0]
        self._actions = self._strayed(self.teacher.act(obs["state"]))

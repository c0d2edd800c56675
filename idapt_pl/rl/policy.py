"""What a policy is to whatever acts in an environment: observations in, actions out."""

from __future__ import annotations

import logging
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from idapt_pl.modules import SAC
from idapt_pl.nets.state_filter import Memory

log = logging.getLogger(__name__)
MUCH_LOST = 0.05
"""Share of steps; a policy that loses the state more often is warned of."""


class Policy(Protocol):
    """Acts in n simulations at once."""

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions float32 (n, nu), in the actuators' units, for what the environment gives as ``pixels``.

        Those are uint8 (n, K, H, W, 3), or states (n, state_dim) in environments that render nothing.
        """


@runtime_checkable
class TimedPolicy(Policy, Protocol):
    """A policy that keeps time: it is told of every control step."""

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; ``ended``, bool (n,), says in which simulations it ended the episode."""


def tick(policy: Policy | None, ended: np.ndarray) -> None:
    """Tell a policy that keeps time that a control step has passed."""
    if isinstance(policy, TimedPolicy):
        policy.tick(ended)


class Acting:
    """A module's policy at work in n simulations, with what it remembers of each.

    Args:
        module: the policy. One without a filter remembers nothing.
        deterministic: act with the mean instead of sampling.
    """

    def __init__(self, module: SAC, deterministic: bool = False) -> None:
        self.module, self.deterministic = module, deterministic
        self.memory: Memory | None = None
        self.readings: Tensor | None = None  # f(o) (n, d), the newest
        self.estimates: Tensor | None = None  # what the actor saw of it

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Actions for what an environment gives as ``pixels``; they are taken to be played."""
        actions = self.on_features(self.module.encode(pixels))
        self.played(actions)
        return actions.cpu().numpy()

    @torch.no_grad()
    def on_features(self, features: Tensor, only: Tensor | None = None) -> Tensor:
        """Actions (n, nu) for features f(o) (n, d); with ``only``, bool (n,), others' memory stays what it was."""
        if self.memory is None:
            self.memory = self.module.begin(len(features))
        if only is None or self.memory is None:
            return self._choose(features)
        before = self.memory.copy()
        actions = self._choose(features)
        self.memory.put_back(before, ~only)
        return actions

    def _choose(self, features: Tensor) -> Tensor:
        self.readings, self.estimates = features, self.module.remembering(features, self.memory)
        return self.module.actor(self.estimates, self.deterministic)[0]

    def played(self, actions: Tensor) -> None:
        """Remember the actions (n, nu) that were played, whoever chose them."""
        if self.memory is not None:
            self.memory.action = self.module.actor.normalise(actions)

    @property
    def lost(self) -> float | None:
        """Share of the steps so far in which what it remembers was lost; None if it remembers nothing."""
        if self.memory is None or self.memory.lost is None:
            return None
        return float(self.memory.lost.sum()) / max(1, self.memory.steps * len(self.memory.lost))

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; episodes that ended are forgotten."""
        if self.memory is not None and ended.any():
            self.memory.forget(torch.from_numpy(ended).to(self.memory.hidden.device))


def warn_if_lost(lost: float | None, where: str) -> None:
    """Warn of a policy that lost the state in more than a few of its steps.

    Args:
        lost: share of the steps; None where nothing is remembered that could be lost.
        where: it acted, as the warning begins.
    """
    if lost is not None and lost > MUCH_LOST:
        log.warning(
            "%s: the policy loses the state in %.0f %% of its steps: what it reads there is unlike anything in the "
            "grounded source. Look at G's pictures in the report",
            where,
            100 * lost,
        )


def deterministic(module: SAC) -> Acting:
    """A module's policy, acting with its mean, at the beginning of episodes."""
    return Acting(module, deterministic=True)

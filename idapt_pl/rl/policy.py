"""What a policy is to whatever acts in an environment: observations in, actions out."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from idapt_pl.modules import SAC


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


def deterministic(module: SAC) -> Policy:
    """A module's policy, acting with its mean."""
    return lambda pixels: module.act(pixels, deterministic=True)

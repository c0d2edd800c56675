"""How a policy on true states is trained on a task."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ExpertRecipe:
    """How SAC on states is trained.

    Args:
        steps: environment steps.
        updates_per_step: critic and actor updates for each of them.
        batch: transitions in a minibatch.
        warmup_steps: random steps before; the scale of the states is taken from them.
        num_envs: simulations side by side.
        gamma: discount.
    """

    steps: int
    updates_per_step: float = 1.0
    batch: int = 128
    warmup_steps: int = 1000
    num_envs: int = 4
    gamma: float = 0.99

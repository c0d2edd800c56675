"""What a target's actuators are told for the policy's actions, where they have other names for the same thing."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space

from idapt_pl.envs.image_env import StepResult
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper


class MappedActions(ImageEnvWrapper):
    """Takes the source's actions, and tells the target ``scale * action[order] + offset``.

    Args:
        env: the target.
        low: lower bounds of the source's actions (nu,).
        high: upper bounds.
        order: which of the source's actions each of the target's is; default as they are.
        scale: what a unit of the source's action is in the target's; default 1.
        offset: what the source's zero is; default 0.

    Raises:
        ValueError: if the numbers do not fit.
    """

    def __init__(self, env: ImageEnv, low: np.ndarray, high: np.ndarray, **how: Any) -> None:
        super().__init__(env)
        theirs = env.single_action_space
        assert isinstance(theirs, gymnasium.spaces.Box)  # as of all image environments
        n = len(theirs.low)
        if unknown := set(how) - {"order", "scale", "offset"}:
            raise ValueError(f"target.actions has {', '.join(sorted(unknown))}; it takes order, scale and offset")
        self._order = numbers("order", how.get("order", range(n)), n).astype(int)
        self._scale, self._offset = (numbers(k, how.get(k, [d] * n), n) for k, d in (("scale", 1.0), ("offset", 0.0)))
        if sorted(self._order) != list(range(len(low))):
            raise ValueError(
                f"target.actions: the target has {n} actions and the source {len(low)}, and the order is "
                f"{self._order.tolist()}. Each of the source's must be one of the target's"
            )
        ends = np.sort([self._scale * b[self._order] + self._offset for b in (low, high)], axis=0)
        if not how and not np.allclose(ends, [theirs.low, theirs.high], rtol=1e-3):
            scale = (theirs.high - theirs.low) / (high - low)
            offset = theirs.low - scale * low
            raise ValueError(
                f"the source's actions are {low.tolist()} to {high.tolist()}, the target's {theirs.low.tolist()} to "
                f"{theirs.high.tolist()}. If they are the same in other units: target.actions: {{scale: "
                f"{scale.round(6).tolist()}, offset: {offset.round(6).tolist()}}}. If they are in the same units: "
                "target.actions: {scale: 1}, and what is out of bounds is clipped"
            )
        self.single_action_space = gymnasium.spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: np.ndarray) -> StepResult:
        """A control step with the source's actions, float32 (n, nu)."""
        return self.env.step((self._scale * actions[:, self._order] + self._offset).astype(np.float32))


def numbers(key: str, values: Any, n: int) -> np.ndarray:
    """A list of n finite numbers, or one for all.

    Raises:
        ValueError: if it is none.
    """
    try:
        array = np.asarray(values, dtype=float)
        array = np.full(n, float(array)) if array.ndim == 0 else array
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ValueError(f"target.actions.{key} is {values}; give {n} numbers, one for each of the target's actions")
    return array

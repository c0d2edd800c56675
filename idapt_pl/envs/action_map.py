"""What a target's actuators are told for the policy's actions, where they have other words for the same thing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space

from idapt_pl.envs.image_env import StepResult
from idapt_pl.envs.wrapper import ImageEnv, ImageEnvWrapper


@dataclass(frozen=True, eq=False)
class ActionMap:
    """``scale * action[order] + offset``.

    Attributes:
        low: lower bounds of the source's actions (nu,).
        high: upper bounds.
        order: which of the source's actions each of the target's is (nu,).
        scale: what a unit of the source's action is in the target's (nu,).
        offset: what the source's zero is (nu,).
        names: of the target's actions, by the source's actuators.
        declared: whether a config says anything of it.
    """

    low: np.ndarray
    high: np.ndarray
    order: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    names: tuple[str, ...] = ()
    declared: bool = False

    @classmethod
    def from_config(
        cls, said: Mapping[str, Any], low: np.ndarray, high: np.ndarray, names: Sequence[str] = ()
    ) -> ActionMap:
        """From ``target.actions``.

        Raises:
            ValueError: if the numbers make no sense.
        """
        n = len(low)
        if unknown := set(said) - {"order", "scale", "offset"}:
            raise ValueError(f"target.actions has {', '.join(sorted(unknown))}; it takes order, scale and offset")
        order = numbers("order", said.get("order", range(n)), n)
        if sorted(order) != list(range(n)):
            raise ValueError(
                f"target.actions.order is {said.get('order')}; each of the numbers 0 to {n - 1} must be there once: "
                "which of the source's actions each of the target's is"
            )
        scale, offset = (numbers(key, said.get(key, value), n) for key, value in (("scale", 1.0), ("offset", 0.0)))
        if not scale.all():
            raise ValueError(f"target.actions.scale is {said.get('scale')}; with 0 an action would do nothing")
        order = order.astype(int)
        return cls(low, high, order, scale, offset, tuple(names[i] for i in order) if names else (), bool(said))

    def __call__(self, actions: np.ndarray) -> np.ndarray:
        """The target's actions for the source's, float32 (n, nu) both."""
        return (self.scale * actions[:, self.order] + self.offset).astype(np.float32)

    def back(self, actions: np.ndarray) -> np.ndarray:
        """The source's actions for the target's, float32 (n, nu) both."""
        source = np.empty(actions.shape, np.float32)
        source[:, self.order] = (actions - self.offset) / self.scale
        return source

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the target's actions that it gives."""
        low, high = np.sort([self.scale * bound[self.order] + self.offset for bound in (self.low, self.high)], axis=0)
        return low, high

    def check(self, low: np.ndarray, high: np.ndarray) -> None:
        """Whether a target with these bounds can be told such actions.

        Raises:
            ValueError: if it has others; the message says what to write.
        """
        if len(low) != len(self.low):
            raise ValueError(f"the target has {len(low)} actions and the source {len(self.low)}; they must be as many")
        if self.declared or np.allclose(self.ends, [low, high], rtol=1e-3):
            return
        scale = (high - low) / (self.high - self.low)
        offset = low - scale * self.low
        cure = f"scale: {scale.round(6).tolist()}, offset: {offset.round(6).tolist()}"
        raise ValueError(
            f"the source's actions are {self.low.tolist()} to {self.high.tolist()}, the target's {low.tolist()} to "
            f"{high.tolist()}. If they are the same in other units: target.actions: {{{cure}}}. If they are in the "
            "same units: target.actions: {scale: 1}, and what is out of bounds is clipped"
        )


class MappedActions(ImageEnvWrapper):
    """Takes the source's actions and tells the target its own.

    Args:
        env: the target.
        to_target: source's actions to the target's.

    Raises:
        ValueError: if the target takes others.
    """

    def __init__(self, env: ImageEnv, to_target: ActionMap) -> None:
        super().__init__(env)
        theirs = env.single_action_space
        assert isinstance(theirs, gymnasium.spaces.Box)  # as of all image environments
        to_target.check(theirs.low, theirs.high)
        self._to_target = to_target
        low, high = to_target.low.astype(np.float32), to_target.high.astype(np.float32)
        self.single_action_space = gymnasium.spaces.Box(low, high)
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: np.ndarray) -> StepResult:
        """A control step with the source's actions, float32 (n, nu)."""
        return self.env.step(self._to_target(actions))


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

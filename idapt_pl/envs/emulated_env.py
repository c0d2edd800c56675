"""The grounded environment at the speed of physics: what the policy would see is predicted, not rendered."""

from __future__ import annotations

from typing import Protocol

import gymnasium
import numpy as np

from idapt_pl.envs.grounded_env import TransformAction


class Emulate(Protocol):
    """Predicts what an encoder makes of translated images, from the source's state."""

    glimpses: int

    def glimpse(self, states: np.ndarray) -> np.ndarray:
        """What one image shows: states (n, state_dim) to (n, m)."""

    def combine(self, glimpses: np.ndarray) -> np.ndarray:
        """Features f of a stack: (n, K, m), oldest first, to (n, d)."""

    def covers(self, states: np.ndarray) -> np.ndarray:
        """Whether states lie where predictions were learned, (n,) bool."""


class EmulatedEnv(gymnasium.vector.VectorWrapper):
    """Source environment, moved through F, whose observations hold ``features`` f(G(o^S)) in place of images.

    f(G(o^S)) depends on nothing but the source's state, which is known: so rendering, G and the encoder
    can be left out of the loop. A state outside of what the emulation covers ends the episode: there the
    images could not have been read either.

    Args:
        env: the source, ``blind``.
        emulate: predicts glimpses and combines them.
        F: action transformation on features, or None for identity.
    """

    def __init__(self, env, emulate: Emulate, F: TransformAction | None = None) -> None:
        super().__init__(env)
        self.emulate, self.F = emulate, F
        self._glimpses: np.ndarray | None = None  # (n, K, m)

    def reset(self, **kwargs):
        obs, infos = self.env.reset(**kwargs)
        self._glimpses = np.repeat(self.emulate.glimpse(obs["state"])[:, None], self.emulate.glimpses, axis=1)
        return self._observe(obs), infos

    def step(self, actions: np.ndarray):
        if self.F is not None:
            actions = self.F(self.emulate.combine(self._glimpses), actions)
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        done = terminations | truncations
        last = infos.get("final_obs", obs)
        self._glimpses = np.concatenate([self._glimpses[:, 1:], self.emulate.glimpse(last["state"])[:, None]], 1)
        lost = ~self.emulate.covers(last["state"]) & ~done
        if lost.any():
            for i in np.flatnonzero(lost):
                self.env.unwrapped.reset_one(i)
            obs = {"state": self.env.unwrapped.states()}
            terminations, done = terminations | lost, done | lost
        if done.any():
            infos = {"final_obs": self._observe(last), "_final_obs": done}
            fresh = self.emulate.glimpse(obs["state"])
            self._glimpses[done] = fresh[done][:, None]
        return self._observe(obs), rewards, terminations, truncations, infos

    def _observe(self, obs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"features": self.emulate.combine(self._glimpses), "state": obs["state"]}

"""Returns of whole episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.vector import VectorEnv

from idapt_pl.rl.policy import Policy, tick


@dataclass(frozen=True)
class Returns:
    """Undiscounted returns of whole episodes; ``interactions`` is what they cost.

    ``successes`` says for each episode whether its goal was reached at any time, for tasks whose metric is success;
    the mean and spread are then of that, else of the returns.
    """

    returns: tuple[float, ...]
    interactions: int
    successes: tuple[bool, ...] = ()

    @classmethod
    def of(cls, outcomes: Sequence[EpisodeOutcome]) -> Returns:
        """Of outcomes; episodes that were not played to their end only cost."""
        whole = [o for o in outcomes if o.whole]
        reached = tuple(o.reached for o in whole if o.reached is not None)
        return cls(tuple(o.gained for o in whole), sum(o.steps for o in outcomes), reached)

    @property
    def mean(self) -> float:
        return float(np.mean(self.successes or self.returns))

    def to_dict(self) -> dict:
        """For JSON."""
        values = {"returns": list(self.returns), "successes": list(self.successes)}
        return {"mean": self.mean, "std": self.std, **values, "interactions": self.interactions}

    @property
    def std(self) -> float:
        return float(np.std(self.successes or self.returns))


@dataclass(frozen=True)
class EpisodeOutcome:
    """What an episode brought.

    Attributes:
        gained: its undiscounted return.
        reached: whether its goal was reached at any time; None for tasks whose metric is another.
        steps: control steps that it took.
        whole: whether it was played to its end.
    """

    gained: float
    reached: bool | None
    steps: int
    whole: bool = True


Watch = Callable[[dict[str, np.ndarray]], None]
"""Is shown what the environment showed, each time after the policy has acted on it."""


Keep = Callable[[EpisodeOutcome], None]
"""Is given every new outcome."""


def evaluate(
    env: VectorEnv, act: Policy, episodes: int, seed: int, watch: Watch | None = None,
    before: Sequence[EpisodeOutcome] = (), keep: Keep | None = None,
) -> Returns:  # fmt: skip
    """Returns of ``episodes`` whole episodes, played ``env.num_envs`` at a time.

    Given a target with its reward it reads that; nothing that trains or selects has such a one.

    Args:
        env: what is played.
        act: the policy.
        episodes: how many.
        seed: of the first start; the others follow.
        watch: sees what the policy saw.
        before: outcomes that there are already.
        keep: is given every new outcome, those of episodes too that something ended before their time.
    """
    outcomes = list(before)
    while (finished := sum(o.whole for o in outcomes)) < episodes:
        playing = np.arange(env.num_envs) < episodes - finished
        outcomes += play_together(env, act, playing, seed + finished, watch, keep or (lambda outcome: None))
    return Returns.of(outcomes)


def play_together(
    env: VectorEnv, act: Policy, playing: np.ndarray, seed: int, watch: Watch | None, keep: Keep
) -> list[EpisodeOutcome]:
    """One episode of each simulation that is ``playing``, bool (n,)."""
    chosen = np.flatnonzero(playing)
    total, steps = np.zeros(env.num_envs), np.zeros(env.num_envs, int)
    reached: np.ndarray | None = None
    playing = playing.copy()

    def outcome(i: int) -> EpisodeOutcome:
        return EpisodeOutcome(
            float(total[i]), None if reached is None else bool(reached[i]), int(steps[i]), not playing[i]
        )

    try:
        obs, _ = env.reset(seed=seed)
        while playing.any():
            actions = act(obs["pixels"])
            if watch is not None:
                watch(obs)
            obs, rewards, terminations, truncations, infos = env.step(actions)
            total += rewards * playing
            steps += playing
            if "success" in infos:
                reached = (np.zeros_like(playing) if reached is None else reached) | (infos["success"] & playing)
            ended = terminations | truncations
            playing &= ~ended
            tick(act, ended if playing.any() else np.ones_like(ended))  # all begin anew with the next reset
    finally:  # also where a robot fails, or a person stops it
        outcomes = [outcome(i) for i in map(int, chosen) if steps[i]]
        for made in outcomes:
            keep(made)
    return outcomes

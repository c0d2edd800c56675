"""Collecting trajectories from environments."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.envs import ImageEnv
from idapt_pl.rl.exploration import look_into
from idapt_pl.rl.policy import Policy, tick

LABELS = ("state", "simulation")
"""What is recorded beside images where an environment shows it."""


def collect(
    env: ImageEnv, act: Policy, steps: int, seed: int, source: str, pixels: str = "pixels",
    keep: Callable[[Episode], None] | None = None, horizon: int | None = None,
) -> Trajectories:  # fmt: skip
    """Exactly ``steps`` control steps, cut into episodes; the last one of each simulation may be unfinished.

    States and rewards are recorded where the environment shows them, which the target does not.

    Args:
        env: any of the image environments.
        act: the policy.
        steps: control steps, over all simulations together.
        seed: of the environment's resets.
        source: free text for the file.
        pixels: which images to record, ``"pixels"`` or a grounded environment's ``"source_pixels"``.
        keep: is given every episode when it ends, and the one that is under way when something fails.
        horizon: control steps after which an episode is begun anew; None where the environment says when. For one
            simulation alone.
    """
    episodes = tuple(episode for _, episode in play(env, act, steps, seed, pixels, keep, horizon))
    return Trajectories(episodes, env.dt, source)


def replay(
    env: ImageEnv, recordings: Sequence[Episode], seed: int, source: str, pixels: str = "pixels",
    horizon: int | None = None,
) -> Trajectories:  # fmt: skip
    """The actions of recorded episodes again, each from a start of its own and until it or its recording ends.

    Args:
        env: of one simulation.
        recordings: whose actions (T, nu) are played, whatever there is to see.
        seed: of the environment's resets.
        source: free text for the file.
        pixels: which images to record, as in :func:`collect`.
        horizon: control steps of each episode that are played; None for all.
    """
    episodes = []
    obs, _ = env.reset(seed=seed)
    for recording in recordings:
        builder = _EpisodeBuilder(obs, 0, pixels)
        ended = False
        for action in recording.actions[:horizon]:
            obs, rewards, terminations, truncations, infos = env.step(action[None])
            builder.add(action, infos.get("final_obs", obs), 0, (rewards[0], terminations[0], truncations[0]))
            if ended := bool(terminations[0] or truncations[0]):
                break
        episodes.append(builder.finish("state" in obs))
        if not ended:
            obs, _ = env.reset()
    return Trajectories(tuple(episodes), env.dt, source)


def collect_each(env: ImageEnv, act: Policy, steps: int, seed: int) -> list[Trajectories]:
    """As :func:`collect`, but ``steps`` of every simulation, each one's episodes on their own."""
    played = play(env, act, steps * env.num_envs, seed, "pixels")
    of_each = [tuple(episode for i, episode in played if i == n) for n in range(env.num_envs)]
    return [Trajectories(episodes, env.dt, "") for episodes in of_each]


def play(
    env: ImageEnv, act: Policy, steps: int, seed: int, pixels: str, keep: Callable[[Episode], None] | None = None,
    horizon: int | None = None,
) -> list[tuple[int, Episode]]:  # fmt: skip
    """What :func:`collect` records, in the order in which episodes end, and which simulation each is of."""
    assert horizon is None or env.num_envs == 1
    look_into(act, env)
    obs, _ = env.reset(seed=seed)
    labelled = "state" in obs
    episodes: list[tuple[int, Episode]] = []
    running = [_EpisodeBuilder(obs, i, pixels) for i in range(env.num_envs)]
    taken = 0
    try:
        while taken < steps:
            actions = act(obs["pixels"])
            obs, rewards, terminations, truncations, infos = env.step(actions)
            taken += env.num_envs
            successor = infos.get("final_obs", obs)
            ended = terminations | truncations
            cut = bool(horizon) and len(running[0].actions) + 1 >= (horizon or 0) and not ended.any()
            if cut:
                truncations, ended = np.ones_like(truncations), np.ones_like(ended)
            tick(act, ended)
            for i, builder in enumerate(running):
                builder.add(actions[i], successor, i, (rewards[i], terminations[i], truncations[i]))
                if terminations[i] or truncations[i] or taken >= steps:
                    episodes.append((i, builder.finish(labelled)))
                    running[i] = _EpisodeBuilder(obs, i, pixels)
                    if keep is not None:
                        keep(episodes[-1][1])
            if cut and taken < steps:  # after what was taken is kept: a robot may fail to begin anew
                obs, _ = env.reset()
                running = [_EpisodeBuilder(obs, 0, pixels)]
    except BaseException:  # also of a person who stops a robot
        if keep is not None:
            for builder in running:
                if builder.actions:
                    keep(builder.finish(labelled))
        raise
    return episodes


class _EpisodeBuilder:
    def __init__(self, obs: dict[str, np.ndarray], i: int, pixels: str) -> None:
        self.pixels = pixels
        self.frames: list[np.ndarray] = []
        self.shown: dict[str, list[np.ndarray]] = {name: [] for name in LABELS if name in obs}
        self.actions: list[np.ndarray] = []
        self.outcomes: list[tuple] = []
        self._see(obs, i)

    def _see(self, obs: dict[str, np.ndarray], i: int) -> None:
        self.frames.append(obs[self.pixels][i, -1])
        for name, rows in self.shown.items():
            rows.append(obs[name][i])

    def add(self, action: np.ndarray, obs: dict[str, np.ndarray], i: int, outcome: tuple) -> None:
        self.actions.append(action)
        self.outcomes.append(outcome)
        self._see(obs, i)

    def finish(self, labelled: bool) -> Episode:
        if not labelled:
            return Episode(np.asarray(self.actions), {"pixels": np.asarray(self.frames)})
        rewards, terminations, truncations = map(np.asarray, zip(*self.outcomes, strict=True))
        observations = {"pixels": np.asarray(self.frames)} | {n: np.asarray(rows) for n, rows in self.shown.items()}
        return Episode(np.asarray(self.actions), observations, rewards, terminations, truncations)

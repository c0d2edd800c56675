"""Acting in environments: collecting trajectories, evaluating, and feeding SAC and GARAT."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from torch import Tensor

from datamodules import Episode, Trajectories
from idapt_pl.modules import ActionTransformation, AsymmetricSAC

Act = Callable[[np.ndarray], np.ndarray]
"""A policy: pixels uint8 (n, K, H, W, 3) to actions float32 (n, nu)."""
VectorEnv = gymnasium.vector.VectorEnv


def random_policy(env: VectorEnv, seed: int) -> Act:
    """Uniform actions within the bounds."""
    rng = np.random.default_rng(seed)
    low, high = env.action_space.low, env.action_space.high
    return lambda pixels: rng.uniform(low, high).astype(np.float32)


def babbling_policy(env: VectorEnv, seed: int) -> Act:
    """Motor babbling: uniform actions around an offset, both redrawn with their amplitude now and then.

    Plain uniform actions at full strength shake a system so hard that slow motion is never seen.
    """
    rng = np.random.default_rng(seed)
    low, high = env.action_space.low, env.action_space.high
    center, half_range = (high + low) / 2, (high - low) / 2
    amplitude, offset = np.zeros((2, *low.shape))

    def act(pixels: np.ndarray) -> np.ndarray:
        redraw = rng.random(len(low)) < 0.1
        amplitude[redraw] = rng.random((int(redraw.sum()), 1)) ** 2
        offset[redraw] = rng.uniform(-1, 1, offset[redraw].shape) * amplitude[redraw]
        noise = rng.uniform(-1, 1, low.shape)
        return np.clip(center + half_range * (offset + amplitude * noise), low, high).astype(np.float32)

    return act


def tick(act: Act | None, ended: np.ndarray) -> None:
    """Tell a policy that keeps time that a control step has passed, and in which simulations it ended the episode."""
    if hasattr(act, "tick"):
        act.tick(ended)


EXPLORATION: dict[str, Callable[[VectorEnv, int], Act]] = {"random": random_policy, "babble": babbling_policy}
"""Task-agnostic policies, by the names configs and the command line use."""


def collect(env: VectorEnv, act: Act, steps: int, seed: int, source: str, pixels: str = "pixels") -> Trajectories:
    """Exactly ``steps`` control steps, cut into episodes; the last one of each simulation may be unfinished.

    States and rewards are recorded where the environment shows them, which the target does not.

    Args:
        env: any of the image environments.
        act: the policy.
        steps: control steps, over all simulations together.
        seed: of the environment's resets.
        source: free text for the file.
        pixels: which images to record, ``"pixels"`` or a grounded environment's ``"source_pixels"``.
    """
    episodes = tuple(episode for _, episode in play(env, act, steps, seed, pixels))
    return Trajectories(episodes, env.unwrapped.dt, source)


def collect_each(env: VectorEnv, act: Act, steps: int, seed: int) -> list[Trajectories]:
    """As :func:`collect`, but ``steps`` of every simulation, each one's episodes on their own."""
    played = play(env, act, steps * env.num_envs, seed, "pixels")
    of_each = [tuple(episode for i, episode in played if i == n) for n in range(env.num_envs)]
    return [Trajectories(episodes, env.unwrapped.dt, "") for episodes in of_each]


def play(env: VectorEnv, act: Act, steps: int, seed: int, pixels: str) -> list[tuple[int, Episode]]:
    """What :func:`collect` records, in the order in which episodes end, and which simulation each is of."""
    obs, _ = env.reset(seed=seed)
    labelled = "state" in obs
    episodes: list[tuple[int, Episode]] = []
    running = [_EpisodeBuilder(obs, i, pixels) for i in range(env.num_envs)]
    taken = 0
    while taken < steps:
        actions = act(obs["pixels"])
        obs, rewards, terminations, truncations, infos = env.step(actions)
        tick(act, terminations | truncations)
        successor = infos.get("final_obs", obs)
        taken += env.num_envs
        for i, builder in enumerate(running):
            builder.add(actions[i], successor, i, (rewards[i], terminations[i], truncations[i]))
            if terminations[i] or truncations[i] or taken >= steps:
                episodes.append((i, builder.finish(labelled)))
                running[i] = _EpisodeBuilder(obs, i, pixels)
    return episodes


class _EpisodeBuilder:
    def __init__(self, obs: dict[str, np.ndarray], i: int, pixels: str) -> None:
        self.pixels = pixels
        self.frames, self.states, self.actions, self.outcomes = [], [], [], []
        self._see(obs, i)

    def _see(self, obs: dict[str, np.ndarray], i: int) -> None:
        self.frames.append(obs[self.pixels][i, -1])
        if "state" in obs:
            self.states.append(obs["state"][i])

    def add(self, action: np.ndarray, obs: dict[str, np.ndarray], i: int, outcome: tuple) -> None:
        self.actions.append(action)
        self.outcomes.append(outcome)
        self._see(obs, i)

    def finish(self, labelled: bool) -> Episode:
        if not labelled:
            return Episode(np.asarray(self.actions), {"pixels": np.asarray(self.frames)})
        rewards, terminations, truncations = map(np.asarray, zip(*self.outcomes, strict=True))
        observations = {"pixels": np.asarray(self.frames), "state": np.asarray(self.states)}
        return Episode(np.asarray(self.actions), observations, rewards, terminations, truncations)


@dataclass(frozen=True)
class Returns:
    """Undiscounted returns of whole episodes; ``interactions`` is what they cost.

    ``successes`` says for each episode whether its goal was reached at any time, for tasks whose metric is success;
    the mean and spread are then of that, else of the returns.
    """

    returns: tuple[float, ...]
    interactions: int
    successes: tuple[bool, ...] = ()

    @property
    def mean(self) -> float:
        return float(np.mean(self.successes or self.returns))

    @property
    def std(self) -> float:
        return float(np.std(self.successes or self.returns))


def evaluate(env: VectorEnv, act: Act, episodes: int, seed: int) -> Returns:
    """Returns of ``episodes`` whole episodes, played ``env.num_envs`` at a time.

    Given a target with its reward it reads that; nothing that trains or selects has such a one.
    """
    returns: list[float] = []
    successes: list[bool] = []
    interactions = 0
    while len(returns) < episodes:
        obs, _ = env.reset(seed=seed + len(returns))
        playing = np.arange(env.num_envs) < episodes - len(returns)
        total, reached = np.zeros(env.num_envs), np.zeros(env.num_envs, bool)
        chosen = playing.copy()
        while playing.any():
            obs, rewards, terminations, truncations, infos = env.step(act(obs["pixels"]))
            total += rewards * playing
            reached |= infos.get("success", reached) & playing
            interactions += int(playing.sum())
            playing &= ~(terminations | truncations)
        returns.extend(total[chosen])
        if "success" in infos:
            successes.extend(reached[chosen])
    return Returns(tuple(map(float, returns)), interactions, tuple(map(bool, successes)))


class Experience:
    """Steps an environment once a call and returns the n transitions, for replay.

    The successor of a finished episode is its last observation, not the first of the next one.

    Args:
        env: with states and rewards.
        policy: decides what is remembered of images, and acts on it.
        seed: of the resets.
        random: act at random instead (warm-up of a new policy).
    """

    def __init__(self, env: VectorEnv, policy: AsymmetricSAC, seed: int, random: bool = False) -> None:
        self.env, self.policy = env, policy
        self.act = policy.act_on
        if random:
            draw = random_policy(env, seed)
            self.act = lambda seen: draw(seen["observation"])
        obs, _ = env.reset(seed=seed)
        self.perceive = policy.perception(env.num_envs, seed)
        self._state, self._seen = obs["state"], self.perceive(policy.remember(obs["pixels"]))
        self._return = np.zeros(env.num_envs)
        self._finished: deque[float] = deque(maxlen=20)

    def __call__(self) -> dict[str, np.ndarray]:
        """One step of every simulation: ``observation, state, actions, rewards, terminations, next_*``."""
        state, seen = self._state, self._seen
        actions = self.act(seen)
        obs, rewards, terminations, truncations, infos = self.env.step(actions)
        done = terminations | truncations
        last = infos.get("final_obs", obs)
        next_state, next_seen = last["state"], self.perceive(self.policy.remember(last["pixels"]))
        self._state, self._seen = obs["state"], next_seen
        if done.any():
            self.perceive.renew(done)
            self._seen = self.perceive(self.policy.remember(obs["pixels"]))
        self._return += rewards
        self._finished.extend(self._return[done])
        self._return[done] = 0.0
        return {
            **seen,
            "state": state,
            "actions": actions,
            "rewards": rewards.astype(np.float32),
            "terminations": terminations,
            "next_observation": next_seen["observation"],
            "next_state": next_state,
        }

    @property
    def recent_return(self) -> float:
        """Mean return of the last 20 finished episodes; of the running ones before any has finished."""
        return float(np.mean(self._finished or self._return))


def garat_rollout(
    env: VectorEnv,
    policy: Callable[[Tensor], Tensor],
    F: ActionTransformation,
    length: int,
    seed: int,
    explore: Act | None = None,
    exploring: int = 0,
) -> Callable[[], dict[str, Tensor]]:
    """A function that rolls the current F out for ``length`` steps of each simulation.

    ``env`` is the source seen through G; ``policy`` turns the features that F sees, f_π, into actions; F samples its
    residual and the source steps with the result. The first ``exploring`` simulations take the actions of
    ``explore`` instead, as the task-agnostic target data did.

    Returns:
        Tensors of shape (length, n, ...): ``features``, ``actions`` (the policy's), ``delta`` (F's sample),
        ``next_features``, ``next_actions``, ``ends`` (bool; the next row is another episode).
    """
    obs, _ = env.reset(seed=seed)
    device = F.device

    def choose(features: Tensor, pixels: np.ndarray) -> Tensor:
        actions = policy(features)
        if exploring:
            actions[:exploring] = torch.from_numpy(explore(pixels)[:exploring]).to(device)
        return actions

    @torch.no_grad()
    def roll() -> dict[str, Tensor]:
        nonlocal obs
        rows: list[dict[str, Tensor]] = []
        features = F.encode(obs["pixels"])
        actions = choose(features, obs["pixels"])
        for t in range(length):
            delta = F.residual(F.agent_input(features, actions)).sample()
            obs, _, terminations, truncations, infos = env.step(F.apply_residual(actions, delta).cpu().numpy())
            successor, done = infos.get("final_obs", obs), terminations | truncations
            tick(explore, done)
            row = {"features": features, "actions": actions, "delta": delta}
            row["next_features"] = features = F.encode(successor["pixels"])
            row["next_actions"] = actions = choose(features, successor["pixels"])
            row["ends"] = torch.from_numpy(done | (t == length - 1)).to(device)
            rows.append(row)
            if done.any():
                features, actions = features.clone(), actions.clone()
                features[done] = F.encode(obs["pixels"][done])
                actions[done] = choose(features, obs["pixels"])[done]
        return {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    return roll

"""Collecting, evaluating and feeding, in the small cart world."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from idapt_pl.envs import GroundedEnv, VectorImageEnv
from idapt_pl.modules import ActionTransformation
from idapt_pl.modules.observation_noise import NoObservationNoise
from idapt_pl.rl.collect import collect, collect_each, replay
from idapt_pl.rl.experience import Experience
from idapt_pl.rl.exploration import EXPLORATION, random_policy
from idapt_pl.rl.grounded_rollout import garat_rollout
from idapt_pl.rl.returns import evaluate


@pytest.fixture
def make(cart):
    made = []

    def make(n):
        made.append(VectorImageEnv(cart, cart.domain("source"), n, 16, 2))
        return made[-1]

    yield make
    for env in made:
        env.close()


def push(force):
    return lambda pixels: np.full((len(pixels), 1), force, np.float32)


@pytest.mark.parametrize("steps", [1, 6, 7, 20])
def test_collect_takes_exactly_the_steps_asked_for(make, steps):
    trajectories = collect(make(1), push(0.0), steps, 0, "test")
    assert trajectories.total_steps == steps
    assert [len(e) for e in trajectories] == [6] * (steps // 6) + ([steps % 6] if steps % 6 else [])
    assert trajectories.dt == pytest.approx(0.02)


def test_collecting_each_gives_every_simulation_the_steps_asked_for_and_its_own_episodes(make):
    each = collect_each(make(3), lambda pixels: np.array([[0.0], [100.0], [-100.0]], np.float32), 14, 0)
    assert [trajectories.total_steps for trajectories in each] == [14, 14, 14]
    assert [len(e) for e in each[0]] == [6, 6, 2]
    for trajectories, force in zip(each, (0.0, 100.0, -100.0), strict=True):
        assert {float(a) for episode in trajectories for a in episode.actions[:, 0]} == {force}
        for episode in trajectories:  # no episode of one goes on in another
            np.testing.assert_allclose(episode.rewards, episode.observations["state"][1:, 0], atol=1e-6)


def test_collected_episode_ends_with_its_own_last_observation_not_the_next_ones_first(make):
    first, *_ = collect(make(1), push(100.0), 12, 0, "test")
    assert first.terminations.tolist() == [False] * (len(first) - 1) + [True]
    assert abs(first.observations["state"][-1, 0]) > 0.5
    np.testing.assert_allclose(first.rewards, first.observations["state"][1:, 0], atol=1e-6)  # reward = position after


def test_collected_actions_lead_from_one_observation_to_the_next(make, cart):
    rng = np.random.default_rng(0)
    (episode, *_) = collect(make(1), lambda pixels: rng.uniform(-50, 50, (1, 1)).astype(np.float32), 6, 0, "test")
    replayed = make(1)
    replayed.reset(seed=0)
    for action, state in zip(episode.actions[:-1], episode.observations["state"][1:-1], strict=True):
        obs, *_ = replayed.step(action[None])
        np.testing.assert_array_equal(obs["state"][0], state)


def test_collect_is_reproducible_by_seed(make):
    def images(seed):
        env = make(2)
        return np.concatenate([e.observations["pixels"] for e in collect(env, random_policy(env, seed), 20, seed, "")])

    np.testing.assert_array_equal(images(1), images(1))
    assert (images(1) != images(2)).any()


def test_collect_can_record_the_source_images_of_a_grounded_environment(make):
    def record(which):
        env = GroundedEnv(make(1), G=lambda pixels: 255 - pixels)
        return collect(env, push(50.0), 8, 0, "test", which)

    for seen, source in zip(record("pixels"), record("source_pixels"), strict=True):
        np.testing.assert_array_equal(seen.observations["pixels"], 255 - source.observations["pixels"])


def test_episodes_are_begun_anew_after_the_horizon_that_is_asked_for(make):
    ticks = []

    class Push:
        def __call__(self, pixels):
            return np.zeros((1, 1), np.float32)

        def tick(self, ended):
            ticks.append(bool(ended[0]))

    env = make(1)
    trajectories = collect(env, Push(), 10, 0, "test", horizon=4)
    assert [len(e) for e in trajectories] == [4, 4, 2] and sum(ticks) == 2
    assert [e.truncations[-1] for e in trajectories] == [True, True, False]
    starts = [e.observations["state"][0, 0] for e in trajectories]
    assert len(set(starts)) == 3 and np.abs(starts).max() < 0.2  # each from a start of its own
    assert [len(e) for e in collect(make(1), push(0.0), 12, 0, "test", horizon=9)] == [
        6,
        6,
    ]  # the task's own is shorter
    whole, short = (collect(make(1), push(0.0), 4, 0, "", horizon=h) for h in (None, 4))
    np.testing.assert_array_equal(whole.episodes[0].observations["state"], short.episodes[0].observations["state"])


def test_replayed_episodes_take_the_recorded_actions_and_end_with_the_recording_or_the_episode(make):
    rng = np.random.default_rng(0)
    recorded = collect(make(1), lambda pixels: rng.uniform(-50, 50, (1, 1)).astype(np.float32), 20, 0, "test")
    gentle = collect(make(1), push(0.0), 6, 0, "test").episodes[0]
    again = replay(make(1), [*recorded, gentle], 5, "again")
    assert len(again) == len(recorded) + 1
    for old, new in zip(recorded, again, strict=False):
        assert len(new) <= len(old) and np.array_equal(new.actions, old.actions[: len(new)])
        assert len(new) == len(old) or new.terminations[-1]
    last = again.episodes[-1]
    assert len(last) == 6 and abs(last.observations["state"][0, 0]) < 0.2  # begins anew, after one that was cut
    assert last.observations["state"].shape[0] == 7


@pytest.mark.parametrize("name", EXPLORATION)
def test_exploration_stays_within_bounds_varies_and_is_reproducible(make, name):
    env = make(3)
    a, b = (np.stack([act(np.zeros(3)) for _ in range(200)]) for act in (EXPLORATION[name](env, 5) for _ in range(2)))
    np.testing.assert_array_equal(a, b)
    assert a.shape == (200, 3, 1) and a.dtype == np.float32
    assert np.abs(a).max() <= 100 and a.std() > 5
    assert (a.max() > 50) and (a.min() < -50), "strong actions must occur, both ways"


@pytest.mark.parametrize("n", [1, 2, 3])
def test_evaluate_sums_the_rewards_of_whole_episodes(make, n):
    result = evaluate(make(n), push(0.0), 4, seed=3)
    assert len(result.returns) == 4 and result.interactions == 4 * 6
    if n == 1:
        by_hand = [e.rewards.sum() for k in range(4) for e in collect(make(1), push(0.0), 6, 3 + k, "")]
        np.testing.assert_allclose(result.returns, by_hand)
        assert result.mean == pytest.approx(np.mean(by_hand)) and result.std == pytest.approx(np.std(by_hand))


def test_evaluate_stops_counting_at_the_end_of_the_episode(make):
    result = evaluate(make(1), push(100.0), 1, seed=0)
    (episode,) = collect(make(1), push(100.0), result.interactions, 0, "")
    assert episode.terminations[-1] and result.returns[0] == pytest.approx(episode.rewards.sum())


class Remembering:
    """A policy that keeps images and pushes as hard as it is told to."""

    def __init__(self, force):
        self.force = force

    def remember(self, pixels):
        return {"observation": pixels}

    def observation_noise(self, num_envs, seed):
        return NoObservationNoise()

    def act_on(self, seen):
        return push(self.force)(seen["observation"])


def test_experience_pairs_each_observation_with_its_successor_also_at_the_end(make):
    act = Experience(make(1), Remembering(100.0), seed=0)
    rows = [act() for _ in range(12)]
    end = next(i for i, r in enumerate(rows) if r["terminations"][0])
    assert abs(rows[end]["next_state"][0, 0]) > 0.5, "the successor is the last observation of the episode"
    assert abs(rows[end + 1]["state"][0, 0]) <= 0.1, "and the next transition begins with the next episode"
    for before, after in pairwise(rows[: end + 1]):
        np.testing.assert_array_equal(before["next_state"], after["state"])
        np.testing.assert_array_equal(before["next_observation"], after["observation"])
    assert (rows[end]["next_observation"] != rows[end + 1]["observation"]).any()
    total = sum(r["rewards"][0] for r in rows[: end + 1])
    assert act.recent_return == pytest.approx(total, rel=1e-5) or act._finished[0] == pytest.approx(total, rel=1e-5)


def test_experience_does_not_report_a_time_limit_as_termination(make):
    act = Experience(make(1), Remembering(0.0), seed=0)
    assert not any(act()["terminations"].any() for _ in range(7))


class Mean(torch.nn.Module):
    """The feature is the newest frame's mean."""

    features = 1

    def encode(self, pixels):
        return pixels[:, -1].float().flatten(1).mean(1, keepdim=True) / 255


class Always:
    """A policy on features with one action."""

    def __init__(self, action):
        self.action, self.calls = action, []

    def on_features(self, features, only=None):
        self.calls.append(None if only is None else only.tolist())
        return torch.full((len(features), 1), self.action)

    def played(self, actions):
        self.calls.append("played")

    def tick(self, ended):
        self.calls.append(f"ended {int(ended.sum())}")


def test_garat_rollout_marks_ends_and_continues_within_episodes(make):
    F = ActionTransformation(Mean(), [-100.0], [100.0], hidden=(8,))
    policy = Always(10.0)
    roll = garat_rollout(make(2), policy, F, 13, seed=0)
    for rollout in (roll(), roll()):
        assert {k: v.shape[:2] for k, v in rollout.items()} == dict.fromkeys(rollout, (13, 2))
        ends = rollout["ends"]
        assert ends[-1].all() and ends.sum() >= 4
        same = rollout["next_features"][:-1] == rollout["features"][1:]
        assert same[~ends[:-1]].all(), "within an episode a successor is the next observation"
        assert not same[ends[:-1]].all(), "across an end it is not"
        assert (rollout["actions"] == 10).all() and rollout["delta"].std() > 0
    everywhere, nowhere = (policy.calls.count(only) for only in (None, [False, False]))
    assert policy.calls.count("played") == 26 and everywhere == 27, "each observation is remembered once"
    assert nowhere == 1, "what the second rollout begins with was seen at the end of the first"

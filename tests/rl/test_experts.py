"""Policies on states, and the datasets they make."""

import json
from contextlib import closing

import h5py
import numpy as np
import pytest
import torch

from cli.main import main
from datamodules import read_trajectories
from datamodules.trajectories import content_hash
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.experts import measure_expert, train_expert
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import HalfCheetah, make_task
from idapt_pl.tasks.recipe import ExpertRecipe

QUICK = ExpertRecipe(steps=40, warmup_steps=20, num_envs=2, batch=8)


def test_state_environment_plays_as_the_image_environment_does(cart):
    images, states = (
        VectorImageEnv(cart, cart.domain("source"), 2, 8, 1),
        VectorStateEnv(cart, cart.domain("source"), 2),
    )
    seen = [env.reset(seed=3)[0]["state"] for env in (images, states)]
    np.testing.assert_array_equal(*seen)
    for _ in range(8):
        a, b = (env.step(np.full((2, 1), 80, np.float32)) for env in (images, states))
        np.testing.assert_array_equal(a[0]["state"], b[0]["state"])
        np.testing.assert_array_equal(b[0]["state"], b[0]["pixels"])
        for x, y in zip(a[1:4], b[1:4], strict=True):
            np.testing.assert_array_equal(x, y)
        assert ("final_obs" in a[4]) == ("final_obs" in b[4])
    images.close(), states.close()


def test_episodes_are_cut_as_by_a_time_limit(cart):
    """The other limit is the task's; a cut is no end of the task, so what comes after counts for a policy's value."""
    with closing(VectorStateEnv(cart, cart.domain("source"), 2, horizon=3)) as env:
        env.reset(seed=3)
        played = [env.step(np.zeros((2, 1), np.float32)) for _ in range(4)]
    assert [(bool(ended.any()), bool(cut.all())) for _, _, ended, cut, _ in played] == [
        (False, False), (False, False), (False, True), (False, False),
    ]  # fmt: skip
    assert "final_obs" in played[2][4]


def test_expert_is_trained_once_and_the_same_each_time(cart, tmp_path):
    def train(folder):
        return train_expert(cart, cart.domain("source"), QUICK, Stages(folder, 0, cpu_trainer), "policy")

    first, kept, again = train(tmp_path / "a"), train(tmp_path / "a"), train(tmp_path / "b")
    for other in (kept, again):
        for x, y in zip(first.state_dict().values(), other.state_dict().values(), strict=True):
            assert torch.equal(x, y)
    returns = measure_expert(first, cart, cart.domain("hard"), 4, seed=0)
    assert len(returns.returns) == 4 and returns == measure_expert(kept, cart, cart.domain("hard"), 4, seed=0)


def test_states_are_standardised_for_actor_and_critics_alike():
    policy = StateSAC(2, [-1.0], [1.0], hidden=(8,))
    policy.actor.encoder.fit(torch.tensor([[1.0, 5.0], [3.0, 5.0]]))
    batch = {"state": torch.tensor([[2.0, 6.0]]), "next_state": torch.tensor([[1e9, 5.0]])}
    seen = policy.standardised(batch)
    assert seen["state"].tolist() == seen["observation"].tolist() == [[0.0, 1.0]]
    assert seen["next_state"].tolist() == seen["next_observation"].tolist() == [[10.0, 0.0]]


@pytest.mark.slow
def test_state_sac_balances_the_pole(tmp_path):
    task = make_task("inverted_pendulum")
    recipe = ExpertRecipe(steps=5000)
    policy = train_expert(task, task.domain("source"), recipe, Stages(tmp_path, 0, cpu_trainer), "policy")
    assert measure_expert(policy, task, task.domain("source"), 5, seed=0).mean > 900


def collected(tmp_path, name, *args):
    out = tmp_path / f"{name}.h5"
    argv = ["--steps", "30", "--image-size", "8", "--experts", str(tmp_path / "experts"), "--out", str(out), *args]
    assert main(["collect", *argv]) == 0
    return out


@pytest.fixture
def quick_experts(monkeypatch):
    monkeypatch.setattr(HalfCheetah, "expert", QUICK)


@pytest.mark.parametrize("domain", ["source", "hard"])
def test_a_mixture_shares_the_steps_and_is_the_same_for_the_same_seed(quick_experts, tmp_path, domain, capsys):
    args = ("--task", "half_cheetah", "--domain", domain, "--policy", "random+backwards+expert")
    first, again = (read_trajectories(collected(tmp_path, name, *args)) for name in "ab")
    other = read_trajectories(collected(tmp_path, "c", *args, "--seed", "1"))
    assert first.total_steps == 30 and len(first) == 3
    told = json.loads(first.source)
    assert told["content_sha256"] == content_hash(first.episodes) == content_hash(again.episodes)
    assert content_hash(other.episodes) != told["content_sha256"]
    assert set(told["experts_sha256"]) == {"backwards", "expert"} and told["policy"] == "random+backwards+expert"
    with h5py.File(tmp_path / "a.h5") as f:
        names = set()
        f.visit(lambda name: names.add(name.split("/")[-1]))
    assert ("state" in names) == ("rewards" in names) == (domain == "source"), "a target's file holds neither"


def test_a_task_without_a_direction_has_no_policy_backwards(tmp_path, capsys):
    argv = ["collect", "--task", "fetch_reach", "--domain", "source", "--policy", "random+backwards+expert"]
    assert main([*argv, "--experts", str(tmp_path), "--out", str(tmp_path / "d.h5")]) == 1
    assert "no policy 'backwards'" in capsys.readouterr().err


def test_going_backwards_pays_what_going_forwards_costs():
    forwards, backwards = make_task("half_cheetah"), make_task("half_cheetah").backwards()
    env = VectorStateEnv(forwards, forwards.domain("source"), 1)
    env.reset(seed=0)
    env.step(np.full((1, 6), 0.5, np.float32))
    data, action = env.data[0], np.zeros(6)
    there = forwards.outcome(env.model, data, action)[0]
    assert there != 0 and backwards.outcome(env.model, data, action)[0] == pytest.approx(-there)
    assert make_task("half_cheetah").direction == 1.0

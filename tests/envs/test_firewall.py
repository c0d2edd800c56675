"""Training sees the target's images and actions and nothing else, and every step is counted."""

import json

import h5py
import numpy as np
import pytest

from datamodules import write_trajectories
from idapt_pl.envs import BlindTarget, VectorImageEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.rl.collect import collect
from idapt_pl.worlds import Worlds


@pytest.fixture
def ledger(tmp_path):
    return Ledger(tmp_path / "ledger.json")


@pytest.fixture
def blind(cart, ledger):
    env = BlindTarget(VectorImageEnv(cart, cart.domain("hard"), 2, 16, 2), ledger, 3, "training")
    yield env
    env.close()


def push(pixels):
    return np.full((len(pixels), 1), 100, np.float32)


def test_blind_target_shows_pixels_and_nothing_else_also_at_the_end(blind):
    obs, infos = blind.reset(seed=0)
    assert set(obs) == {"pixels"} and infos == {}
    assert set(blind.observation_space.spaces) == set(blind.single_observation_space.spaces) == {"pixels"}
    ended = False
    for _ in range(12):
        obs, rewards, terminations, truncations, infos = blind.step(push(obs["pixels"]))
        assert set(obs) == {"pixels"} and set(infos) <= {"final_obs", "_final_obs"}
        assert set(infos.get("final_obs", {"pixels"})) == {"pixels"}
        assert np.isnan(rewards).all() and not terminations.any()
        ended |= bool(truncations.any())
    assert ended, "the cart leaves the rail: that the episode ended is visible, why is not"


def test_collected_target_data_have_no_reward_no_state_and_no_reason_for_an_end(blind, tmp_path):
    trajectories = collect(blind, push, 20, 0, "target")
    for e in trajectories:
        assert set(e.observations) == {"pixels"} and e.infos == {}
        assert (e.rewards, e.terminations, e.truncations) == (None, None, None)
    write_trajectories(tmp_path / "target.h5", trajectories)
    found = set()
    with h5py.File(tmp_path / "target.h5") as f:
        f.visit(lambda name: found.add(name.split("/")[-1]))
    assert {n for n in found if not n.startswith("episode_")} == {"actions", "observations", "pixels"}


def test_runs_hand_training_a_blind_target(cart, ledger):
    worlds = Worlds(cart, cart.domain("source"), cart.domain("hard"), ledger, 16, 2)
    env = worlds.blind_target(1)
    assert isinstance(env, BlindTarget) and env.num_envs == 1
    env.close()


def test_every_target_step_of_every_simulation_is_counted(blind, ledger):
    blind.reset(seed=0)
    for _ in range(5):
        blind.step(push(np.zeros(2)))
    ledger.enter(3, "training", 10)
    assert ledger.entries == [{"step": 3, "purpose": "training", "count": 10}]


def test_a_file_that_disagrees_with_what_was_counted_is_an_error(blind, ledger):
    blind.reset(seed=0)
    blind.step(push(np.zeros(2)))
    with pytest.raises(RuntimeError, match=r"2 target interactions were made.*step 3.*has 1"):
        ledger.enter(3, "training", 1)
    assert not ledger.path.exists()


def test_ledger_survives_a_restart_and_repeated_entries_count_once(ledger):
    ledger.enter(0, "training", 100)
    ledger.enter(1, "training", 20)
    again = Ledger(ledger.path)
    again.enter(1, "training", 20)
    assert again.entries == ledger.entries and again.training_total == 120
    assert json.loads(ledger.path.read_text()) == {"training_total": 120, "entries": ledger.entries}


def test_evaluation_and_oracle_are_on_the_ledger_but_not_in_the_methods_total(ledger):
    ledger.enter(0, "training", 100)
    ledger.enter(0, "evaluation", 5000)
    ledger.enter(0, "oracle reference", 7000)
    assert ledger.training_total == 100 and len(ledger.entries) == 3

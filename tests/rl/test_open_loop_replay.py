"""Exploration by what a teacher does in the source, played without looking."""

import json

import numpy as np
import pytest
import torch
from conftest import TINY

from cli.main import main
from datamodules import read_trajectories
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.collect import collect
from idapt_pl.rl.exploration import OpenLoopReplay


@pytest.fixture
def teacher():
    torch.manual_seed(0)
    policy = StateSAC(2, [-100.0], [100.0], (16,))
    policy.actor.encoder.fit(torch.tensor([[-0.3, -2.0], [0.3, 2.0]]))
    policy.actor.head[-1].weight.data[:1] *= 3  # so that it means something
    return policy


def played_by(teacher, cart, n, ends, seed=1, strays=0.0):
    """Actions (steps, n, 1) of a rehearsal that is told of these ends, (steps, n)."""
    torch.manual_seed(seed)
    act, actions = OpenLoopReplay(teacher, VectorStateEnv(cart, cart.domain("source"), n), seed, strays), []
    for ended in ends:
        actions.append(act(np.zeros(n)))
        act.tick(ended)
    return np.asarray(actions)


def test_it_plays_what_the_teacher_does_in_a_source_of_its_own(cart, teacher):
    played = played_by(teacher, cart, 1, np.zeros((5, 1), bool))
    torch.manual_seed(1)
    env = VectorStateEnv(cart, cart.domain("source"), 1)
    obs, by_hand = env.reset(seed=1)[0], []
    for _ in range(5):
        by_hand.append(teacher.act(obs["state"]))
        obs = env.step(by_hand[-1])[0]
    np.testing.assert_array_equal(played, by_hand)
    assert np.ptp(played) > 1


def test_only_the_simulation_that_ended_begins_anew(cart, teacher, monkeypatch):
    monkeypatch.setattr(teacher, "act", lambda states: 100 * states[:, :1])  # tells where the source's cart is
    ends = np.zeros((6, 2), bool)
    undisturbed = played_by(teacher, cart, 2, ends)
    ends[1, 0] = True
    disturbed = played_by(teacher, cart, 2, ends)
    np.testing.assert_array_equal(disturbed[:, 1], undisturbed[:, 1])
    np.testing.assert_array_equal(disturbed[:2], undisturbed[:2])
    assert (disturbed[2:5, 0] != undisturbed[2:5, 0]).all()
    assert abs(disturbed[2, 0]) <= 10, "it starts where episodes start, within 0.1 m"


def test_episodes_of_the_robot_and_of_the_rehearsal_begin_together(cart, teacher, monkeypatch):
    seen = []
    monkeypatch.setattr(teacher, "act", lambda states: seen.append(states[0]) or np.full((1, 1), 90.0, np.float32))
    target = VectorImageEnv(cart, cart.domain("hard"), 1, 16, 1)
    episodes = collect(target, OpenLoopReplay(teacher, VectorStateEnv(cart, cart.domain("source"), 1), 0), 12, 0, "")
    target.close()
    starts = np.cumsum([0, *map(len, episodes.episodes)])[:-1]
    assert len(starts) > 1
    assert all(seen[i][1] == 0 and abs(seen[i][0]) <= 0.1 for i in starts), "at rest where episodes start"


def test_strays_are_played_in_both_worlds_and_the_teacher_sees_where_they_lead(cart, teacher, monkeypatch):
    seen, ends = [], np.zeros((400, 2), bool)
    monkeypatch.setattr(teacher, "act", lambda states: seen.append(states.copy()) or np.zeros((2, 1), np.float32))
    played = played_by(teacher, cart, 2, ends, strays=0.3)
    assert 0.15 < (played != 0).mean() < 0.45 and np.abs(played).max() <= 100
    speeds = np.array(seen)[:, :, 1]
    assert np.abs(speeds).max() > 0.1, "a teacher that does nothing is moved by them"
    np.testing.assert_array_equal(played, played_by(teacher, cart, 2, ends, strays=0.3))
    assert (played_by(teacher, cart, 2, ends) == 0).all()


@pytest.mark.parametrize("kind", ["images", "states"])
def test_a_masked_reset_leaves_the_others_alone(cart, kind):
    domain = cart.domain("source")
    env = VectorImageEnv(cart, domain, 3, 16, 2) if kind == "images" else VectorStateEnv(cart, domain, 3)
    env.reset(seed=0)
    for _ in range(2):
        before = env.step(np.full((3, 1), 60, np.float32))[0]
    after, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    for name in before:
        np.testing.assert_array_equal(after[name][[0, 2]], before[name][[0, 2]])
        assert (after[name][1] != before[name][1]).any(), name
    truncated = env.step(np.zeros((3, 1), np.float32))[3]
    assert not truncated.any()
    for _ in range(3):
        truncated = env.step(np.zeros((3, 1), np.float32))[3]
    assert truncated.tolist() == [True, False, True], "its time begins anew, theirs goes on"
    env.close()


# --- in a run -------------------------------------------------------------------------------------------

TAUGHT = {"teacher__steps": 16, "teacher__adapt": 12, "teacher__dagger": 16, "schedule__grounding_steps": 1}


@pytest.fixture(scope="module")
def rehearsed_run(tmp_path_factory, tiny_args):
    run = tmp_path_factory.mktemp("runs") / "rehearsed"
    args = tiny_args(run, schedule__exploration="rehearse", **TAUGHT)
    assert main(["fit", *args]) == 0
    return run, args


@pytest.mark.slow  # a whole run
def test_a_run_that_rehearses_costs_no_further_target_interactions(rehearsed_run):
    summary = json.loads((rehearsed_run[0] / "summary.json").read_text())
    assert summary["target_interactions"] == TINY["schedule.images"] + TINY["schedule.interactions"]


@pytest.mark.slow  # a whole run
def test_the_targets_recording_holds_images_and_actions_only(rehearsed_run):
    episodes = read_trajectories(rehearsed_run[0] / "step_00/target.h5")
    assert all(set(e.observations) == {"pixels"} and e.rewards is None for e in episodes)
    actions = np.concatenate([e.actions for e in episodes])
    assert len(actions) == TINY["schedule.images"] and actions.std() > 0.01


@pytest.mark.slow  # a whole run
def test_a_run_that_lost_its_exploration_repeats_it_bitwise(rehearsed_run):
    run, args = rehearsed_run
    path = run / "step_00/source.h5"
    before = [e.actions for e in read_trajectories(path)]
    path.unlink()
    assert main(["fit", *args]) == 0
    for a, b in zip(before, read_trajectories(path), strict=True):
        np.testing.assert_array_equal(a, b.actions)


def test_strays_are_refused_where_nothing_is_played_open_loop(tmp_path, tiny_args, capsys):
    options = {"schedule__exploration": "babble", "schedule__exploration_strays": 0.3}
    assert main(["fit", *tiny_args(tmp_path / "run", **options)]) != 0
    assert "schedule.exploration_strays is 0.3" in capsys.readouterr().err


def test_without_a_teacher_there_is_nothing_to_rehearse(tmp_path, tiny_args, capsys):
    assert main(["fit", *tiny_args(tmp_path / "run", schedule__exploration="rehearse")]) != 0
    said = capsys.readouterr().err
    assert "rehearse" in said and "teacher.steps" in said

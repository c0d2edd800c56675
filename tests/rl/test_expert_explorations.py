"""Experts that explore act on the true states of what is played; several policies share its steps evenly."""

from contextlib import closing

import numpy as np
import pytest

from idapt_pl.envs import BlindTarget, VectorImageEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.rl.collect import collect
from idapt_pl.rl.exploration import ExpertAtTheControls, TakingTurns


class Told:
    """Stands in for an expert: pushes with what it sees."""

    def act(self, states):
        self.seen = states
        return np.full((len(states), 1), 7.0, np.float32) + states[:, :1]


class Pushes:
    """Always the same action."""

    def __init__(self, strength):
        self.strength = strength

    def __call__(self, pixels):
        return np.full((len(pixels), 1), self.strength, np.float32)


@pytest.fixture
def blind(cart, tmp_path):
    with closing(VectorImageEnv(cart, cart.domain("hard"), 1, 16, 2)) as env:
        yield BlindTarget(env, Ledger(tmp_path / "ledger.json"), 0, "training")


def test_an_expert_sees_the_targets_true_states_and_the_recording_does_not_hold_them(blind):
    expert = Told()
    made = collect(blind, ExpertAtTheControls(expert, "expert"), 10, 0, "target")
    assert np.array_equal(expert.seen, np.asarray(expert.seen, np.float32)) and expert.seen.shape == (1, 2)
    assert all(set(e.observations) == {"pixels"} and e.rewards is None for e in made)
    assert np.concatenate([e.actions for e in made]).std() > 0, "actions go with the states"


def test_an_expert_without_anything_to_look_into_says_so(cart):
    act = ExpertAtTheControls(Told(), "expert")
    with pytest.raises(ValueError, match="there are none to see"):
        act(np.zeros((1, 2, 16, 16, 3), np.uint8))

    class Robot:
        unwrapped = "a robot"

    with pytest.raises(ValueError, match="is no simulation with them"):
        act.look_into(Robot())


@pytest.mark.parametrize("strengths", [(1.0, -2.0), (1.0, -2.0, 30.0)])
def test_policies_that_take_turns_share_the_steps_to_within_an_episode(cart, strengths):
    with closing(VectorImageEnv(cart, cart.domain("source"), 1, 16, 2)) as env:
        made = collect(env, TakingTurns([Pushes(s) for s in strengths], 1), 120, 0, "source")
    for episode in made:
        assert len(np.unique(episode.actions)) == 1, "an episode is of one policy"
    actions = np.concatenate([e.actions for e in made]).ravel()
    shares = [int((actions == s).sum()) for s in strengths]
    assert sum(shares) == 120 and max(shares) - min(shares) <= cart.horizon


def test_in_several_simulations_each_has_its_turn():
    turns = TakingTurns([Pushes(0.0), Pushes(1.0)], 3)
    for _ in range(4):
        assert turns(np.zeros(3)).ravel().tolist() == [0, 0, 0]
        turns.tick(np.zeros(3, bool))
    turns.tick(np.array([True, False, False]))
    assert turns(np.zeros(3)).ravel().tolist() == [1, 0, 0]

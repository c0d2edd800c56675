"""Trials of a policy in the grounded source: whether it trains again there, and whether it is put back."""

import numpy as np
import pytest
import torch

from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.stage import TRAIN_AGAIN
from idapt_pl.stages.settings import BatchSettings
from idapt_pl.stages.trials import GroundedTrials


def pushing(amount):
    """A policy whose mean action is always the same, as a share of the largest."""
    sizes = {"state_dim": 2, "image_size": 16, "frame_stack": 2, "hidden": (8,)}
    policy = AsymmetricSAC(**sizes, action_low=[-20.0], action_high=[20.0], bf16=False)
    last = policy.actor.head[-1]
    torch.nn.init.zeros_(last.weight)
    last.bias.data = torch.tensor([float(np.arctanh(amount)), 0.0])
    return policy


@pytest.fixture
def judge(cart):
    """The cart is paid for its position. Pushed by constant forces, shares of the largest, before and after."""

    def make_env():
        return VectorImageEnv(cart, cart.domain("source"), 2, 16, 2)

    def judge(before, *attempts, repeats=0, in_source=None):
        trials, policy = GroundedTrials(4, repeats, in_source), pushing(before)
        for n, amount in enumerate(attempts, 1):
            policy.load_state_dict(pushing(amount).state_dict())  # what training made of it
            told = trials(policy, pushing(before), make_env, n)
        pushed = policy.act(np.zeros((1, 2, 16, 16, 3), np.uint8), deterministic=True).item() / 20
        return told, pytest.approx(pushed, rel=1e-4)

    return judge


@pytest.mark.parametrize(
    ("before", "after", "kept"), [(0.9, -0.9, "before"), (-0.9, 0.9, "after"), (0.5, 0.5, "after")]
)
def test_a_policy_that_got_worse_in_its_own_environment_is_put_back(judge, before, after, kept):
    told, pushed = judge(before, after)
    assert told["kept"] == kept and (told["trial_before"] > told["trial_after"]) == (kept == "before")
    assert pushed == max(before, after) and told["trial_kept"] == max(told["trial_before"], told["trial_after"])


def test_a_policy_trains_again_while_it_falls_short_of_the_source_policy(judge):
    told, pushed = judge(0.1, -0.1, repeats=2, in_source=1e3)
    assert told[TRAIN_AGAIN] and "kept" not in told and pushed == -0.1, "it goes on from what it has learned"
    told, pushed = judge(0.1, 0.05, -0.3, repeats=2, in_source=1e3)
    assert told[TRAIN_AGAIN] and pushed == 0.05, "from the best attempt"
    told, pushed = judge(0.1, -0.1, -0.2, 0.05, repeats=2, in_source=1e3)
    assert TRAIN_AGAIN not in told and told["attempts"] == 3 and told["kept"] == "before" and pushed == 0.1


def test_of_several_attempts_the_best_is_kept(judge):
    told, pushed = judge(0.1, 0.6, 0.3, -0.2, repeats=2, in_source=1e3)
    assert told["kept"] == "attempt 1" and pushed == 0.6 and told["trial_kept"] > told["trial_before"]
    told, pushed = judge(0.1, 0.3, 0.6, repeats=1, in_source=1e3)
    assert told["kept"] == "after" and pushed == 0.6


def test_a_policy_that_does_what_the_source_policy_did_trains_once(judge):
    best = judge(0.1, 0.9)[0]["trial_after"]
    assert best > 0
    for in_source, again in ((best, False), (1.09 * best, False), (1.2 * best, True), (None, False)):
        assert (TRAIN_AGAIN in judge(0.1, 0.9, repeats=1, in_source=in_source)[0]) == again


def test_repeats_that_nothing_is_compared_with_are_told(caplog):
    GroundedTrials(1, 2, None)
    assert "feeding.trial_repeats does nothing" in caplog.text
    caplog.clear()
    GroundedTrials(1, 2, 10.0), GroundedTrials(1, 0, None)
    assert not caplog.text


def test_returns_below_zero_fall_short_by_a_tenth_of_their_size():
    trials = GroundedTrials(1, 1, -10.0)
    assert not trials.falls_short(-10.9) and trials.falls_short(-11.1)


def test_repeats_without_episodes_are_refused():
    with pytest.raises(ValueError, match=r"feeding\.trial_repeats is 2, but no episodes"):
        BatchSettings(trial_repeats=2)

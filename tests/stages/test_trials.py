"""Trials of a policy in the grounded source: whether it trains again there, and whether it is put back."""

import numpy as np
import pytest
import torch

from idapt_pl.envs import VectorImageEnv
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.stage import TRAIN_AGAIN
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

    def judge(before, after, repeats, in_source, attempt=1):
        envs = tuple(VectorImageEnv(cart, cart.domain("source"), 2, 16, 2) for _ in range(2))
        old, new = pushing(before), pushing(after)
        told = GroundedTrials(4, repeats, in_source)(new, old, envs, attempt)
        pushed = new.act(np.zeros((1, 2, 16, 16, 3), np.uint8), deterministic=True).item() / 20
        return told, pushed

    return judge


@pytest.mark.parametrize(
    ("before", "after", "kept"), [(0.9, -0.9, "before"), (-0.9, 0.9, "after"), (0.5, 0.5, "after")]
)
def test_a_policy_that_got_worse_in_its_own_environment_is_put_back(judge, before, after, kept):
    told, pushed = judge(before, after, 0, None)
    assert told["kept"] == kept and (told["trial_before"] > told["trial_after"]) == (kept == "before")
    assert pushed == pytest.approx(max(before, after), rel=1e-4)


def test_a_policy_trains_again_while_it_falls_short_of_the_source_policy_and_keeps_what_it_learned_meanwhile(judge):
    told, pushed = judge(0.1, -0.1, 2, in_source=1e3)
    assert told[TRAIN_AGAIN] and "kept" not in told and pushed == pytest.approx(-0.1, rel=1e-4), "not put back yet"
    told, pushed = judge(0.1, -0.1, 2, in_source=1e3, attempt=3)
    assert TRAIN_AGAIN not in told and told["attempts"] == 3 and pushed == pytest.approx(0.1, rel=1e-4)


def test_a_policy_that_does_what_the_source_policy_did_trains_once(judge):
    best = judge(0.1, 0.9, 0, None)[0]["trial_after"]
    assert best > 0
    for in_source, again in ((best, False), (1.09 * best, False), (1.2 * best, True), (None, False)):
        assert (TRAIN_AGAIN in judge(0.1, 0.9, 1, in_source)[0]) == again


def test_returns_below_zero_fall_short_by_a_tenth_of_their_size():
    trials = GroundedTrials(1, 1, -10.0)
    assert not trials.falls_short(-10.9) and trials.falls_short(-11.1)

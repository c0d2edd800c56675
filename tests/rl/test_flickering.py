"""A policy that acts on estimates with the noise that it trains with."""

import numpy as np
import pytest
import torch

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.nets.encoder import Vision
from idapt_pl.rl.flickering import FlickeringPolicy
from idapt_pl.rl.policy import deterministic


def policy(flicker):
    torch.manual_seed(0)
    vision = Vision(strides=(2, 2, 1, 1), pool="keypoints", rates="differences")
    sizes = {"state_dim": 2, "rates": {1: 0}, "dt": 0.04, "image_size": 32, "hidden": (8,), "bf16": False}
    made = AsymmetricSAC(
        action_low=[-3.0], action_high=[3.0], vision=vision, encoder="supervised", flicker=flicker, **sizes
    )
    made.actor.encoder.std.copy_(torch.tensor([0.1, 1.0]))
    return made


@pytest.fixture
def images():
    return np.random.default_rng(0).integers(0, 256, (3, 3, 32, 32, 3), dtype=np.uint8)


def test_without_flicker_it_is_the_policy_with_its_mean_action(images):
    made = policy(0.0)
    assert np.array_equal(FlickeringPolicy(made, 3, seed=0)(images), deterministic(made)(images))


def test_it_acts_on_the_estimates_with_their_noise(images):
    made = policy(0.2)
    act, plain = FlickeringPolicy(made, 3, seed=0), deterministic(made)
    plain(images)
    noise = made.flicker(3, seed=0)
    for _ in range(3):
        actions = act(images)
        expected = noise({"observation": plain.readings.numpy()})["observation"]
        assert np.allclose(act.readings, expected, atol=1e-6)
        assert np.allclose(actions, made.actor(torch.from_numpy(expected), True)[0].detach(), atol=1e-6)


def test_a_new_episode_begins_with_rates_as_they_are_read(images):
    made = policy(0.2)
    act, plain = FlickeringPolicy(made, 3, seed=0), deterministic(made)
    plain(images)
    act(images)
    act(images)
    act.tick(np.array([False, False, True]))
    act(images)
    same = (act.readings[:, 1] == plain.readings[:, 1]).tolist()
    assert same == [False, False, True]

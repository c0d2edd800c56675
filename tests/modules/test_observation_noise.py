"""What a policy sees of its estimates while it trains: laws of the gains and offsets."""

import numpy as np
import pytest
import torch

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.modules.observation_noise import NoObservationNoise, ObservationNoise
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.images import jitter

PENDULUM = {"state_dim": 4, "image_size": 32, "rates": {2: 0, 3: 1}, "dt": 0.04}


def policy(**overrides):
    vision = Vision(strides=(2, 2, 1, 1), pool="keypoints", rates="differences")
    return AsymmetricSAC(
        action_low=[-3.0],
        action_high=[3.0],
        hidden=(8,),
        vision=vision,
        **PENDULUM,
        **{"encoder": "supervised"} | overrides,
    )


def test_rates_share_the_gain_of_their_position_and_have_no_offset():
    perceive = ObservationNoise(policy().actor.encoder, 5, 0.1, seed=0)
    assert np.array_equal(perceive.gain[:, 2:], perceive.gain[:, :2])
    assert (perceive.offset[:, 2:] == 0).all() and (perceive.offset[:, :2] != 0).all()


def test_only_finished_episodes_are_misperceived_in_another_way():
    perceive = ObservationNoise(policy().actor.encoder, 3, 0.1, seed=0)
    seen = {"observation": np.ones((3, 4), np.float32), "pixels": np.zeros(3)}
    before = perceive(seen)
    perceive.renew(np.array([False, True, False]))
    after = perceive(seen)
    same = (before["observation"] == after["observation"]).all(1)
    assert same.tolist() == [True, False, True]
    assert after["pixels"] is seen["pixels"]


def test_spread_is_as_asked():
    perceive = ObservationNoise(policy().actor.encoder, 20_000, 0.1, seed=0)
    assert perceive.gain[:, :2].std() == pytest.approx(0.1, rel=0.03)
    assert perceive.offset[:, :2].std() == pytest.approx(0.1, rel=0.03)


@pytest.mark.parametrize("settings", [{"misperception": 0.0}, {"misperception": 0.1, "encoder": "learned"}])
def test_nothing_is_misperceived_where_nothing_is_estimated_or_asked_for(settings):
    assert type(policy(**settings).observation_noise(2, 0)) is NoObservationNoise


def test_jitter_keeps_the_mean_image_and_changes_each_one():
    torch.manual_seed(0)
    images = torch.full((4000, 1, 2, 2), 0.5)
    jittered = jitter(images, 0.2)
    assert jittered.mean().item() == pytest.approx(0.5, abs=0.01)
    assert jittered.mean((1, 2, 3)).std() == pytest.approx(np.hypot(0.5 * 0.2, 0.1) / np.sqrt(3), rel=0.1)
    assert jitter(images, 0.0) is images

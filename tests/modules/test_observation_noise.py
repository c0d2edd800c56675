"""What a policy sees of its estimates while it trains: laws of gains, offsets and noise from image to image."""

import numpy as np
import pytest
import torch

from idapt_pl.modules import AsymmetricSAC, StateSAC
from idapt_pl.modules.observation_noise import (
    Flicker,
    MixedNoise,
    NoObservationNoise,
    ObservationNoise,
    RecordedErrors,
    SlowNoise,
)
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


def scaled_encoder():
    encoder = policy().actor.encoder
    encoder.std.copy_(torch.tensor([0.05, 0.1, 0.5, 1.2]))
    return encoder


def unit(n):
    return {"observation": np.zeros((n, 4), np.float32)}


def test_flicker_is_as_large_as_asked_and_a_rate_has_what_three_frames_make_of_it():
    encoder = scaled_encoder()
    see = Flicker(encoder, 50_000, 0.05, seed=0)
    before = [see(unit(50_000))["observation"] for _ in range(3)][-1]
    now = see(unit(50_000))["observation"]
    assert now[:, :2].std(0) == pytest.approx([0.05, 0.05], rel=0.02)
    assert np.abs(np.corrcoef(now[:, 1], before[:, 1])[0, 1]) < 0.02, "every image has its own"
    per_second = 0.05 * np.sqrt(1.5**2 + 2**2 + 0.5**2) / 0.04
    assert now[:, 2:].std(0) == pytest.approx(per_second * np.array([0.05 / 0.5, 0.1 / 1.2]), rel=0.02)


def test_flickering_rates_are_those_that_the_encoder_takes_from_flickering_positions():
    encoder = scaled_encoder()
    see = Flicker(encoder, 1, 0.05, seed=0)
    seen = np.concatenate([see(unit(1))["observation"] for _ in range(3)])
    positions = torch.from_numpy(seen[:, :2]).double() * encoder.std[:2]
    step = positions.diff(dim=0)
    slope = (1.5 * step[1] - 0.5 * step[0]) / 0.04
    assert seen[2, 2:] * encoder.std[2:].numpy() == pytest.approx(slope.numpy(), rel=1e-5)


def test_an_episode_begins_with_rates_at_rest_while_others_go_on():
    see = Flicker(scaled_encoder(), 3, 0.05, seed=0)
    assert (see(unit(3))["observation"][:, 2:] == 0).all()
    assert (see(unit(3))["observation"][:, 2:] != 0).all()
    see.renew(np.array([False, True, False]))
    now = see(unit(3))["observation"]
    assert (now[:, 2:] == 0).all(1).tolist() == [False, True, False] and (now[:, :2] != 0).all()


def test_rates_are_taken_from_as_many_frames_as_the_encoder_sees():
    encoder = scaled_encoder()
    see = Flicker(encoder, 1, 0.05, seed=0, frames=2)
    seen = np.concatenate([see(unit(1))["observation"] for _ in range(3)])
    last = (seen[2, :2] - seen[1, :2]) * encoder.std[:2].numpy() / 0.04
    assert seen[2, 2:] * encoder.std[2:].numpy() == pytest.approx(last, rel=1e-5)


def test_a_single_frame_flickers_where_no_rates_are_taken_from_frames():
    encoder = Vision(pool="keypoints").predictor(32, 1, 4, {2: 0, 3: 1}, 0.04)
    seen = Flicker(encoder, 20_000, 0.05, seed=0, frames=1)(unit(20_000))["observation"]
    assert seen.std(0) == pytest.approx(4 * [0.05], rel=0.03)


def test_what_shows_nothing_new_stays_as_it_was():
    """Where another episode ends, its first observation is seen as well, and the others have no new one."""
    encoder = scaled_encoder()
    see = Flicker(encoder, 2, 0.05, seed=0)
    first = see(unit(2))["observation"]
    see(unit(2), np.array([True, False]))
    later = see(unit(2))["observation"]
    slope = 1.5 * (later[1, :2] - first[1, :2]) * encoder.std[:2].numpy() / 0.04
    assert later[1, 2:] * encoder.std[2:].numpy() == pytest.approx(slope, rel=1e-5)

    only, states = np.array([True, False]), {"observation": np.zeros((2, 1), np.float32)}
    slow = SlowNoise(np.ones(1), 2, 1.0, 0.0, seed=0)
    before = slow._now.copy()
    slow(states, only)
    assert ((slow._now == before)[:, 0] == ~only).all()
    played = RecordedErrors([np.arange(1.0, 31.0)[:, None]], 2, seed=0)
    played(states)
    at = played._at.copy()
    played(states, only)
    assert ((played._at == at) == ~only).all()


def test_gains_and_offsets_go_with_flicker():
    both = policy(misperception=0.1, flicker=0.05).observation_noise(2, 0)
    slow = policy(misperception=0.1).observation_noise(2, 0)
    ones = {"observation": np.ones((2, 4), np.float32)}
    assert np.array_equal(slow(ones)["observation"], slow(ones)["observation"])
    first, second = (both(ones)["observation"] for _ in range(2))
    assert (first != second)[:, :2].all()
    assert np.allclose(first[:, 2:], slow(ones)["observation"][:, 2:]), "the first image of an episode shows no rates"
    both.renew(np.array([True, False]))
    third = both(ones)["observation"]
    assert (third[0, 2:] != first[0, 2:]).all(), "another gain"


NOTHING_SEEN_WRONGLY = [
    {"misperception": 0.0},
    {"misperception": 0.1, "encoder": "learned"},
    {"flicker": 0.1, "encoder": "learned"},
]


@pytest.mark.parametrize("settings", NOTHING_SEEN_WRONGLY)
def test_nothing_is_misperceived_where_nothing_is_estimated_or_asked_for(settings):
    assert type(policy(**settings).observation_noise(2, 0)) is NoObservationNoise


def test_jitter_keeps_the_mean_image_and_changes_each_one():
    torch.manual_seed(0)
    images = torch.full((4000, 1, 2, 2), 0.5)
    jittered = jitter(images, 0.2)
    assert jittered.mean().item() == pytest.approx(0.5, abs=0.01)
    assert jittered.mean((1, 2, 3)).std() == pytest.approx(np.hypot(0.5 * 0.2, 0.1) / np.sqrt(3), rel=0.1)
    assert jitter(images, 0.0) is images


def test_each_episode_has_one_of_several_noises_and_another_may_follow():
    n = 400
    slow = SlowNoise(np.ones(2), n, 0.0, 0.1, seed=0)
    recorded = RecordedErrors([np.full((4000, 2), 5.0)], n, seed=0)
    either = MixedNoise([slow, recorded], n, seed=0)
    nothing = {"observation": np.zeros((n, 2), np.float32), "other": 3}

    def large():
        seen = either(nothing)
        assert seen["other"] == 3
        return np.abs(seen["observation"]).max(1) > 1.0

    first = large()
    assert 0.3 < first.mean() < 0.6, "half of the episodes, those whose factor is small aside"
    assert np.array_equal(large(), first), "an episode keeps its noise"
    anew = np.arange(n) < n // 2
    either.renew(anew)
    second = large()
    assert np.array_equal(second[~anew], first[~anew]) and 0.2 < np.mean(second[anew] != first[anew]) < 0.7


def test_a_teacher_that_is_hardened_goes_on_bearing_what_it_bore():
    """Else it falls from where it stood, as a walker did that had learned to walk with noise."""
    bounds = {"low": [-1.0], "high": [1.0]}
    hardened, noiseless = (StateSAC(2, bounds["low"], bounds["high"], hidden=[8], noise=x) for x in (0.2, 0.0))
    for module in (hardened, noiseless):
        module.recorded_errors = [np.full((4000, 2), 50.0)]
    seen = {"observation": np.zeros((100, 2), np.float32)}
    for module, least, most in ((hardened, 0.3, 0.7), (noiseless, 0.9, 1.0)):
        far = np.abs(module.observation_noise(100, seed=0)(seen)["observation"]).max(1) > 1.0
        assert least < far.mean() <= most

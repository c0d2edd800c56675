"""Randomised environments: variants are what they say, and one that is the source is the source to the bit."""

from contextlib import closing

import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorRotation
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.distribution import distribution_from
from idapt_pl.effects.joints import JointDamping
from idapt_pl.effects.visual import Color
from idapt_pl.envs import VectorImageEnv, VectorStateEnv
from idapt_pl.randomisation.settings import draw_variants
from idapt_pl.tasks import make_task


def played(env, steps=30, seed=5):
    """Everything that an environment shows along seeded random actions."""
    rng, low, high = np.random.default_rng(0), env.single_action_space.low, env.single_action_space.high
    with closing(env):
        obs, _ = env.reset(seed=seed)
        told = [obs["pixels"], obs["state"]]
        for _ in range(steps):
            obs, rewards, terminations, truncations, infos = env.step(
                rng.uniform(low, high, (env.num_envs, len(low))).astype(np.float32)
            )
            told += [obs["pixels"], obs["state"], rewards, terminations, truncations]
            told += [infos["final_obs"]["pixels"]] if "final_obs" in infos else []
    return told


def same(one, other):
    return len(one) == len(other) and all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


NOTHING_WIDE = [
    {"effect": "body_mass", "target": "pole", "parameters": {"mass": {"uniform": [4.895, 4.895]}}},
    {"effect": "camera_pose", "target": "view", "parameters": {"azimuth": {"log_uniform": [90, 90]}}},
    {"effect": "color", "target": "cart", "parameters": {"rgba": {"uniform": [[0.7, 0.7, 0, 1], [0.7, 0.7, 0, 1]]}}},
]


@pytest.mark.parametrize("number", [1, 3])
def test_a_distribution_of_no_width_is_the_source_to_the_bit(number):
    task = make_task("inverted_pendulum", {})
    source = task.domain("source")
    variants = draw_variants(distribution_from(NOTHING_WIDE), source, number, seed=0)
    plain = played(VectorImageEnv(task, source, 2, 32, 2))
    assert same(plain, played(VectorImageEnv(task, source, 2, 32, 2, variants=variants)))
    states = played(VectorStateEnv(task, source, 2))
    assert same(states, played(VectorStateEnv(task, source, 2, variants)))


def test_a_wide_distribution_is_not(cart):
    source = cart.domain("source")
    variants = [source.with_effects(BodyMass("cart", m)) for m in (1.0, 100.0)]
    assert not same(played(VectorStateEnv(cart, source, 2)), played(VectorStateEnv(cart, source, 2, variants)))


def test_every_episode_begins_in_a_variant_that_is_drawn_and_stays_in_it(cart):
    source = cart.domain("source")
    variants = [source.with_effects(BodyMass("cart", m), Color("box", (c, 0, 0, 1))) for m, c in ((1, 1), (50, 0.2))]
    looks, masses = set(), []
    with closing(VectorImageEnv(cart, source, 1, 16, 1, variants=variants)) as env:
        env.reset(seed=0)
        for _ in range(60):
            before = env.models[0]
            obs, _, terminations, truncations, _ = env.step(np.zeros((1, 1), np.float32))
            if not (terminations | truncations)[0]:
                assert env.models[0] is before
            body = float(env.models[0].body("cart").mass[0])
            masses.append(body)
            looks.add((body, int(obs["pixels"].max())))
    assert set(masses) == {1.0, 50.0} and len({m for m, _ in looks}) == 2
    brightest = {m: max(v for n, v in looks if n == m) for m in (1.0, 50.0)}
    assert brightest[1.0] > brightest[50.0] + 30, "each variant is drawn with its own looks"


def test_the_simulations_of_an_environment_are_in_variants_of_their_own_and_are_stepped_in_them(cart):
    source = cart.domain("source")
    variants = [source.with_effects(BodyMass("cart", m)) for m in (1.0, 1000.0)]
    with closing(VectorStateEnv(cart, source, 16, variants)) as env:
        env.reset(seed=1)
        heavy = np.array([m.body("cart").mass[0] > 10 for m in env.models])
        assert heavy.sum() == 8, "each as often as the other"
        obs, *_ = env.step(np.full((16, 1), 20, np.float32))
        speeds = np.abs(obs["state"][:, 1])
    assert speeds[heavy].max() < 0.01 * speeds[~heavy].min()


def test_every_variant_comes_once_before_any_comes_again_also_across_resets(cart):
    source = cart.domain("source")
    variants = [source.with_effects(BodyMass("cart", m)) for m in (1.0, 2.0, 3.0, 4.0, 5.0)]
    with closing(VectorStateEnv(cart, source, 2, variants)) as env:
        for seed in (0, 1):
            env.reset(seed=seed)
            drawn = env._drawn.tolist()
            while len(drawn) < 20:
                env.reset()
                drawn += env._drawn.tolist()
            rounds = np.reshape(drawn, (4, 5))
            assert (np.sort(rounds) == np.arange(5)).all() and len({tuple(r) for r in rounds.tolist()}) > 1


def test_commands_go_through_each_variants_own_effects():
    task = make_task("fetch_reach", {})
    source = task.domain("source")
    turned = source.with_effects(ActuatorRotation("x y", np.pi / 2))
    with closing(VectorStateEnv(task, source, 8, (source, turned))) as env:
        env.reset(seed=0)
        is_turned = env._drawn == 1
        assert 0 < is_turned.sum() < 8
        before = env.states()[:, :2]
        actions = np.tile(np.array([1, 0, 0, 0], np.float32), (8, 1))
        for _ in range(3):
            env.step(actions)
        moved = env.states()[:, :2] - before
    assert (np.abs(moved[is_turned, 1]) > 3 * np.abs(moved[is_turned, 0])).all()
    assert (np.abs(moved[~is_turned, 0]) > 3 * np.abs(moved[~is_turned, 1])).all()


def test_the_same_seed_draws_the_same_variants(cart):
    source = cart.domain("source")
    variants = [source.with_effects(JointDamping("slide", d)) for d in (0.0, 50.0)]
    make = lambda: VectorStateEnv(cart, source, 3, variants)  # noqa: E731
    assert same(played(make()), played(make())) and not same(played(make()), played(make(), seed=6))


def test_a_variant_with_other_joints_is_refused(cart):
    source, pendulum = cart.domain("source"), make_task("inverted_pendulum", {}).domain("source")
    with pytest.raises(ValueError, match="may not add or take away joints or actuators"):
        VectorStateEnv(cart, source, 1, (pendulum,))

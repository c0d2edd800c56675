"""Image environments: laws of the grounded environment, time limits, frame stacks, determinism."""

from contextlib import closing

import numpy as np
import pytest

from idapt_pl.effects import Domain, View
from idapt_pl.effects.visual import Blur
from idapt_pl.envs import BlindTarget, GroundedEnv, StatesOnly, VectorImageEnv
from idapt_pl.envs.ledger import Ledger

K, SIZE, N = 3, 16, 2


@pytest.fixture
def make(cart):
    """Makes a small source environment; closes all of them at the end."""
    made = []

    def make(n=N, domain="source", **kwargs):
        made.append(VectorImageEnv(cart, cart.domain(domain), n, SIZE, K, **kwargs))
        return made[-1]

    yield make
    for env in made:
        env.close()


def pushes(steps, n=N, seed=1):
    """Actions hard enough that some episodes terminate before the time limit."""
    return np.random.default_rng(seed).uniform(-100, 250, (steps, n, 1)).astype(np.float32)


def play(env, actions, seed=0):
    """Everything an environment shows, as a list of dictionaries of arrays."""
    seen = [env.reset(seed=seed)[0]]
    for action in actions:
        obs, rewards, terminations, truncations, infos = env.step(action)
        final = {f"final_{k}": v for k, v in infos.get("final_obs", {}).items()}
        seen.append({**obs, **final, "rewards": rewards, "terminations": terminations, "truncations": truncations})
    return seen


def assert_same(
    a, b, names=("pixels", "state", "rewards", "terminations", "truncations", "final_pixels", "final_state")
):
    for t, (x, y) in enumerate(zip(a, b, strict=True)):
        for name in names:
            assert (name in x) == (name in y), f"step {t}: {name}"
            if name in x:
                np.testing.assert_array_equal(x[name], y[name], err_msg=f"step {t}: {name}")


@pytest.mark.parametrize(
    "identity",
    [
        {},
        {"G": lambda pixels: pixels},
        {"G": lambda pixels: pixels, "frames": K},
        {"F": lambda pixels, actions: actions},
        {"G": lambda pixels: pixels, "F": lambda pixels, actions: actions},
    ],
    ids=["left_out", "G_framewise", "G_stackwise", "F", "G_and_F"],
)
def test_identity_grounding_reproduces_the_source_bit_for_bit(make, identity):
    actions = pushes(20)
    source = play(make(), actions)
    grounded = play(GroundedEnv(make(), **identity), actions)
    assert_same(source, grounded)
    ends = np.stack([s["terminations"] for s in source[1:]]), np.stack([s["truncations"] for s in source[1:]])
    assert all(e.any() for e in ends), "both kinds of end must occur for this to say much"


@pytest.mark.parametrize("frames", [1, K])
def test_grounded_pixels_are_the_translation_of_the_source_pixels(make, frames):
    """Also across resets and in the last observation of an episode."""
    actions = pushes(20)
    source = play(make(), actions)
    grounded = play(GroundedEnv(make(), G=lambda pixels: 255 - pixels, frames=frames), actions)
    assert_same(source, grounded, ("state", "rewards", "terminations", "truncations", "final_state"))
    for s, g in zip(source, grounded, strict=True):
        np.testing.assert_array_equal(g["pixels"], 255 - s["pixels"])
        np.testing.assert_array_equal(g["source_pixels"], s["pixels"])
        if "final_pixels" in s:
            np.testing.assert_array_equal(g["final_pixels"], 255 - s["final_pixels"])
            np.testing.assert_array_equal(g["final_source_pixels"], s["final_pixels"])


def test_the_source_steps_with_what_F_makes_of_the_translated_observation_and_the_action(make):
    actions, seen = pushes(20), []

    def F(pixels, a):
        seen.append(pixels.copy())
        return 0.5 * a

    source = play(make(), 0.5 * actions)
    grounded = play(GroundedEnv(make(), G=lambda pixels: 255 - pixels, F=F), actions)
    assert_same(source, grounded, ("state", "rewards", "terminations", "truncations"))
    for before, pixels in zip(source, seen, strict=False):  # F acts on what the policy saw
        np.testing.assert_array_equal(pixels, 255 - before["pixels"])


def test_what_a_policy_does_to_its_observation_does_not_reach_the_grounded_stack(make):
    env = GroundedEnv(make(), G=lambda pixels: pixels)
    obs, _ = env.reset(seed=0)
    older = obs["pixels"][:, 1:].copy()
    obs["pixels"][:] = 0
    obs, *_ = env.step(np.zeros((N, 1), np.float32))
    np.testing.assert_array_equal(obs["pixels"][:, :-1], older)


@pytest.mark.parametrize(
    "wrap", [lambda env: env, lambda env: GroundedEnv(env, G=lambda p: p)], ids=["source", "grounded"]
)
def test_frame_stack_after_autoreset_repeats_the_fresh_frame(make, wrap):
    env = wrap(make())
    resets = 0
    for t, s in enumerate(play(env, pushes(20))):
        fresh = np.ones(N, bool) if t == 0 else s["terminations"] | s["truncations"]
        for i in np.flatnonzero(fresh):
            resets += 1
            assert (s["pixels"][i] == s["pixels"][i, -1]).all()
    assert resets > N


def test_frame_stack_holds_the_last_frames_oldest_first(make):
    seen = play(make(1), np.full((4, 1, 1), 60, np.float32))
    newest = [s["pixels"][0, -1] for s in seen]
    np.testing.assert_array_equal(seen[4]["pixels"][0], newest[2:5])
    assert (newest[2] != newest[4]).any()


def test_time_limit_is_truncation_not_termination(make, cart):
    seen = play(make(1), np.zeros((cart.horizon, 1, 1), np.float32))
    assert not any(s["terminations"].any() for s in seen[1:])
    assert [bool(s["truncations"][0]) for s in seen[1:]] == [False] * (cart.horizon - 1) + [True]


def test_leaving_the_rail_is_termination_not_truncation_and_final_obs_is_where_it_ended(make):
    seen = play(make(1), np.full((6, 1, 1), 100, np.float32))
    end = next(s for s in seen[1:] if s["terminations"][0])
    assert not end["truncations"][0]
    assert abs(end["final_state"][0, 0]) > 0.5 and abs(end["state"][0, 0]) <= 0.1


def test_same_seed_same_episodes_and_another_seed_others(make):
    actions = pushes(12)
    a, b, c = (play(make(), actions, seed) for seed in (7, 7, 8))
    assert_same(a, b)
    assert (a[0]["state"] != c[0]["state"]).any()


def test_reseeding_an_environment_that_has_played_starts_it_over(make):
    env, actions = make(), pushes(12)
    assert_same(play(env, actions, 7), play(env, actions, 7))


def test_simulations_do_not_influence_each_other(make):
    actions = np.zeros((1, N, 1), np.float32)
    actions[0, 1] = 50
    still, pushed = play(make(), 0 * actions), play(make(), actions)
    np.testing.assert_array_equal(still[1]["state"][0], pushed[1]["state"][0])
    assert (still[1]["state"][1] != pushed[1]["state"][1]).all()


def test_actions_are_clipped_to_the_control_range(make):
    a, b = (play(make(1), np.full((3, 1, 1), push, np.float32)) for push in (100, 1e6))
    assert_same(a, b)


def test_observations_and_actions_have_the_declared_spaces(make):
    env = make()
    obs, _ = env.reset(seed=0)
    assert env.observation_space["pixels"].contains(obs["pixels"]) and obs["pixels"].shape == (
        N,
        K,
        SIZE,
        SIZE,
        3,
    )
    assert env.observation_space["state"].contains(obs["state"])
    assert env.single_action_space.low == -100 and env.single_action_space.high == 100
    assert env.dt == pytest.approx(0.02)


def test_wrappers_tell_the_control_period_of_what_they_wrap(make, tmp_path):
    env = make(n=1)
    grounded, blind = GroundedEnv(env), BlindTarget(env, Ledger(tmp_path / "ledger.json"), 0, "training")
    assert grounded.dt == StatesOnly(grounded).dt == blind.dt == env.dt


def test_view_shows_the_middle_of_the_image(make):
    """Half the view at half the size is the middle of the whole image, up to resampling."""
    whole, part = make(1), make(1, view=View(0.5))
    wide, near = (env.reset(seed=0)[0]["pixels"][0, -1].astype(float) for env in (whole, part))
    middle = wide[SIZE // 4 : -SIZE // 4, SIZE // 4 : -SIZE // 4]
    shrunk = near.reshape(SIZE // 2, 2, SIZE // 2, 2, 3).mean((1, 3))
    assert np.abs(middle - shrunk).mean() < 8 < np.abs(wide - near).mean()


def test_view_up_shows_what_lies_above(make):
    whole, part = make(1), make(1, view=View(0.5, up=0.25))
    wide, near = (env.reset(seed=0)[0]["pixels"][0, -1].astype(float) for env in (whole, part))
    shrunk = near.reshape(SIZE // 2, 2, SIZE // 2, 2, 3).mean((1, 3))
    above, below = wide[: SIZE // 2, SIZE // 4 : -SIZE // 4], wide[SIZE // 2 :, SIZE // 4 : -SIZE // 4]
    assert np.abs(above - shrunk).mean() < 8 < np.abs(below - shrunk).mean()


def test_a_view_larger_than_the_image_is_refused():
    with pytest.raises(ValueError, match=r"view.share must be in \(0, 1\], got 2"):
        View(2.0)


def test_frames_are_the_same_to_the_bit_whatever_process_renders_them(make):
    """Three simulations in two processes, across resets and their final observations."""
    actions = pushes(20, 3)
    assert_same(play(make(3), actions), play(make(3, render_processes=1), actions))


def test_frames_of_a_blurred_domain_are_too(cart):
    source = cart.domain("source")
    soft = Domain("soft", source.base, (*source.effects, Blur("world", 0.05)))
    with (
        closing(VectorImageEnv(cart, soft, 2, SIZE, 1)) as here,
        closing(VectorImageEnv(cart, soft, 2, SIZE, 1, render_processes=1)) as there,
    ):
        assert_same(play(here, pushes(3)), play(there, pushes(3)))


def test_set_state_shows_the_state_it_was_given(make):
    a, b = make(1), make(1)
    a.reset(seed=0), b.reset(seed=5)
    frames = [env.set_state(0, np.array([0.2]), np.array([0.0])) for env in (a, b)]
    np.testing.assert_array_equal(*frames)
    assert (frames[0] != a.set_state(0, np.array([-0.2]), np.array([0.0]))).any()

"""Tasks against the published environments, and their domains against what they declare."""

import gymnasium
import mujoco
import numpy as np
import pytest

from idapt_pl.envs import VectorImageEnv
from idapt_pl.tasks import TASKS, make_task

DOMAINS = ("source", "easy", "hard")


@pytest.fixture(scope="module")
def pendulum():
    task = make_task("inverted_pendulum")
    return {name: task.domain(name).compile() for name in DOMAINS}


def test_pendulum_agrees_with_gymnasium_on_observation_reward_and_termination():
    env = VectorImageEnv(make_task("inverted_pendulum"), make_task("inverted_pendulum").domain("source"), 1, 16)
    reference = gymnasium.make("InvertedPendulum-v5").unwrapped
    for field in ("body_mass", "body_inertia", "body_subtreemass"):  # the task's mass is the older MuJoCo's
        getattr(reference.model, field)[:] = getattr(env.model, field)
    mujoco.mj_setConst(reference.model, reference.data)
    rng, terminated = np.random.default_rng(0), False
    env.reset(seed=0)
    reference.reset(seed=0)
    reference.set_state(env.data[0].qpos.copy(), env.data[0].qvel.copy())
    steps = 0
    while not terminated and steps < 500:
        steps += 1
        action = rng.uniform(-3, 3, 1).astype(np.float32)
        obs, rewards, terminations, _, infos = env.step(action[None])
        expected, reward, terminated, _, _ = reference.step(action)
        seen = infos["final_obs"] if terminations[0] else obs
        np.testing.assert_allclose(seen["state"][0], expected, atol=1e-6)
        assert (rewards[0], terminations[0]) == (reward, terminated)
    env.close()
    assert terminated and steps > 3, "the pole must fall, after a while, for this to compare anything"
    assert env.dt == reference.dt and env.single_action_space == reference.action_space


def test_pendulum_horizon_is_gymnasiums():
    assert make_task("inverted_pendulum").horizon == gymnasium.spec("InvertedPendulum-v5").max_episode_steps


@pytest.mark.parametrize(("domain", "mass"), [("source", 4.895), ("easy", 50.0), ("hard", 200.0)])
def test_pole_mass_is_table_1s_and_inertia_scales_along(pendulum, domain, mass):
    source, model = pendulum["source"].body("pole"), pendulum[domain].body("pole")
    assert model.mass[0] == pytest.approx(mass)
    np.testing.assert_allclose(model.inertia / source.inertia, mass / 4.895, rtol=1e-9)


DERIVED = {
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "dof_M0",
    "actuator_acc0",
}  # follow from masses
LOOKS = ("geom_rgba", "geom_matid", "mat_", "tex_", "cam_", "light_", "name_", "names", "paths", "text")


@pytest.mark.parametrize("domain", ["easy", "hard"])
def test_domain_differs_from_the_source_only_in_what_it_declares(pendulum, domain):
    source, model = pendulum["source"], pendulum[domain]
    arrays = [k for k in dir(source) if k[0] != "_" and isinstance(getattr(source, k, None), np.ndarray)]
    differ = {k for k in arrays if not np.array_equal(getattr(source, k), getattr(model, k))}
    moved = {k for k in differ if not k.startswith(LOOKS)}
    assert {"body_mass", "body_inertia"} <= moved <= {"body_mass", "body_inertia"} | DERIVED
    pole = source.body("pole").id
    assert set(np.flatnonzero(source.body_mass != model.body_mass)) == {pole}
    np.testing.assert_array_equal(source.dof_damping, model.dof_damping)
    assert (source.opt.timestep, source.opt.integrator) == (model.opt.timestep, model.opt.integrator)
    np.testing.assert_array_equal(source.opt.gravity, model.opt.gravity)
    camera_moved = bool({"cam_pos", "cam_quat", "cam_fovy"} & differ)
    assert camera_moved == (domain == "hard"), "only the hard domain moves the camera"


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("domain", DOMAINS)
def test_every_task_plays_in_every_domain_and_looks_like_something(name, domain):
    task = make_task(name)
    env = VectorImageEnv(task, task.domain(domain), 1, 32, 1)
    obs, _ = env.reset(seed=0)
    obs, rewards, *_ = env.step(env.action_space.sample())
    env.close()
    assert np.isfinite(obs["state"]).all() and np.isfinite(rewards).all()
    assert obs["pixels"].std() > 5, "the image is flat"


def test_domains_show_the_same_state_differently(pendulum):
    task, frames = make_task("inverted_pendulum"), []
    for name in DOMAINS:
        env = VectorImageEnv(task, task.domain(name), 1, 32, 1)
        env.reset(seed=0)
        frames.append(env.set_state(0, np.zeros(2), np.zeros(2)).astype(float))
        env.close()
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(frames[a] - frames[b]).mean() > 3


def test_unknown_names_are_errors_that_list_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown task 'pendulum'.*inverted_pendulum"):
        make_task("pendulum")
    with pytest.raises(ValueError, match="no domain 'harder'; it has: source, easy, hard"):
        make_task("inverted_pendulum").domain("harder")

"""Tasks against the published environments, and their domains against what they declare."""

from contextlib import closing

import gymnasium
import mujoco
import numpy as np
import pytest

from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.differences import differences
from idapt_pl.envs import VectorImageEnv
from idapt_pl.tasks import TASKS, make_task

DOMAINS = ("source", "easy", "hard")


@pytest.fixture(scope="module")
def models():
    """Compiled models, by task and domain; made once."""
    made = {}

    def get(task, domain):
        if (task, domain) not in made:
            made[task, domain] = make_task(task).domain(domain).compile()
        return made[task, domain]

    return get


GYMNASIUM = {"inverted_pendulum": "InvertedPendulum-v5", "half_cheetah": "HalfCheetah-v5", "walker2d": "Walker2d-v5"}


@pytest.mark.parametrize("name", GYMNASIUM)
def test_task_agrees_with_gymnasium_on_observation_reward_and_termination(name):
    """Step by step on the same states; a control step of ours is ``action_repeat`` of theirs."""
    task = make_task(name)
    env = VectorImageEnv(task, task.domain("source"), 1, 16)
    options = {"xml_file": "walker2d.xml"} if name == "walker2d" else {}
    reference = gymnasium.make(GYMNASIUM[name], **options).unwrapped
    copy_masses(env.model, reference)  # the tasks' masses are the older MuJoCo's
    env.reset(seed=0)
    reference.reset(seed=0)
    env.action_space.seed(0)
    compared, ended = 0, False
    while not ended and compared < 60:
        reference.set_state(env.data[0].qpos.copy(), env.data[0].qvel.copy())
        actions = env.action_space.sample()
        obs, rewards, terminations, _, infos = env.step(actions)
        total = 0.0
        for _ in range(task.action_repeat):
            expected, reward, ended, _, _ = reference.step(actions[0])
            total += reward + (name == "walker2d" and ended)  # v5 no longer pays for the step in which it falls
            if ended:
                break
        seen = infos["final_obs"] if terminations[0] else obs
        np.testing.assert_allclose(seen["state"][0], expected, rtol=1e-5, atol=1e-5)
        assert rewards[0] == pytest.approx(total, abs=1e-5) and terminations[0] == ended
        compared += 1
    env.close()
    assert compared > 3 and (ended or name == "half_cheetah"), "something must happen for this to compare anything"
    assert env.dt == pytest.approx(reference.dt * task.action_repeat)
    assert env.single_action_space == reference.action_space
    assert task.horizon * task.action_repeat == gymnasium.spec(GYMNASIUM[name]).max_episode_steps


def copy_masses(model, reference):
    for field in ("body_mass", "body_inertia", "body_subtreemass"):
        getattr(reference.model, field)[:] = getattr(model, field)
    mujoco.mj_setConst(reference.model, reference.data)


@pytest.mark.parametrize("name", GYMNASIUM)
def test_start_states_are_drawn_as_gymnasium_draws_them(name):
    """Spread of positions and velocities over many starts, against the reference's."""
    task, model = make_task(name), make_task(name).domain("source").compile()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    reference, theirs, ours = gymnasium.make(GYMNASIUM[name]).unwrapped, [], []
    for seed in range(300):
        reference.reset(seed=seed)
        task.reset(model, data, rng)
        theirs.append(np.concatenate([reference.data.qpos, reference.data.qvel]))
        ours.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(np.mean(ours, 0), np.mean(theirs, 0), atol=0.03)
    np.testing.assert_allclose(np.std(ours, 0), np.std(theirs, 0), rtol=0.2)


MASS = {
    "inverted_pendulum": {"source": 4.895, "easy": 50.0, "hard": 200.0},
    "walker2d": {"source": 3.534, "easy": 5.4, "hard": 10.0},
}
ARMATURE = {"source": 0.1, "easy": 0.18, "hard": 0.4}


@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize(("task", "body"), [("inverted_pendulum", "pole"), ("walker2d", "torso")])
def test_masses_are_table_1s_and_inertia_scales_along(models, task, body, domain):
    mass = MASS[task]
    source, model = models(task, "source").body(body), models(task, domain).body(body)
    assert model.mass[0] == pytest.approx(mass[domain])
    np.testing.assert_allclose(model.inertia / source.inertia, mass[domain] / mass["source"], rtol=1e-9)


@pytest.mark.parametrize("domain", DOMAINS)
def test_cheetah_armature_is_table_1s_on_all_driven_joints_and_it_weighs_14_kg(models, domain):
    model = models("half_cheetah", domain)
    np.testing.assert_array_equal(model.dof_armature, [0, 0, 0] + 6 * [ARMATURE[domain]])
    assert model.body_mass.sum() == pytest.approx(14.0)


def test_walker_feet_have_the_friction_of_the_papers_time(models):
    model = models("walker2d", "source")
    assert (model.geom("foot_geom").friction[0], model.geom("foot_left_geom").friction[0]) == (0.9, 1.9)


JOINTS = ("bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")
PHYSICS = {
    "inverted_pendulum": {("body_mass", "pole"), ("body_inertia", "pole")},
    "half_cheetah": {("dof_armature", j) for j in JOINTS},
    "walker2d": {("body_mass", "torso"), ("body_inertia", "torso")},
    "fetch_reach": set(),  # the easy one's rotation has no words in MJCF
    "fetch_reach hard": {("actuator_biasprm", "z"), ("actuator_biastype", "z")},
    "sawyer_push": {("body_mass", "puck"), ("body_inertia", "puck")},
}
"""The fields of the compiled models that may differ from the source's, apart from what is only seen."""
CAMERA_MOVES = {*((name, "hard") for name in TASKS), ("fetch_reach", "easy")}


@pytest.mark.parametrize("domain", ["easy", "hard"])
@pytest.mark.parametrize("name", TASKS)
def test_domain_differs_from_the_source_only_in_what_it_declares(models, name, domain):
    found = differences(models(name, "source"), models(name, domain))
    expected = PHYSICS.get(f"{name} {domain}", PHYSICS[name])
    assert {(d.field, d.element) for d in found if not d.visual} == expected
    assert any(d.field.startswith("cam_") for d in found) == ((name, domain) in CAMERA_MOVES)
    assert any(d.visual for d in found)


def test_differences_are_none_between_a_model_and_itself(models):
    for name in TASKS:
        assert differences(models(name, "source"), make_task(name).domain("source").compile()) == []


def test_differences_see_fields_that_no_effect_of_ours_touches():
    task = make_task("walker2d")
    changed = task.domain("source").spec()
    changed.option.timestep, changed.joint("leg_joint").damping = 0.001, [0.2, 0, 0]
    found = {(d.field, d.element) for d in differences(task.domain("source").spec().compile(), changed.compile())}
    assert found == {("opt.timestep", "world"), ("dof_damping", "leg_joint")}


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


@pytest.mark.parametrize("name", TASKS)
def test_domains_show_the_same_state_differently_and_always_in_the_same_way(name):
    task, frames = make_task(name), []
    for _ in range(2):
        for domain in DOMAINS:
            with closing(VectorImageEnv(task, task.domain(domain), 1, 32, 1)) as env:
                frames.append(env.reset(seed=0)[0]["pixels"][0, -1].astype(float))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(frames[a] - frames[b]).mean() > 3
    for first, second in zip(frames[:3], frames[3:], strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["inverted_pendulum", "half_cheetah", "walker2d"])
def test_every_motor_can_be_named_in_an_effect(name):
    source = make_task(name).domain("source")
    model = source.compile()
    for i in range(model.nu):
        weaker = source.with_effects(ActuatorGain(model.actuator(i).name, 0.5)).compile()
        assert np.flatnonzero(weaker.actuator_gainprm[:, 0] != model.actuator_gainprm[:, 0]).tolist() == [i]


def test_unknown_names_are_errors_that_list_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown task 'pendulum'.*inverted_pendulum"):
        make_task("pendulum")
    with pytest.raises(ValueError, match="no domain 'harder'; it has: source, easy, hard"):
        make_task("inverted_pendulum").domain("harder")


def test_turns_of_a_cheetah_that_rolls_are_told_by_no_state_and_by_its_motion():
    """One picture has one state, however often it rolled over before; positions over time do not jump."""
    task = make_task("half_cheetah")
    model = task.domain("source").compile()
    data = mujoco.MjData(model)

    def lying(pitch):
        data.qpos[2] = pitch
        return task.state(model, data)

    np.testing.assert_allclose(lying(-3.0), lying(2 * np.pi - 3.0), atol=1e-12)
    np.testing.assert_allclose(lying(3.3 - 4 * np.pi), lying(3.3), atol=1e-12)
    rolling = np.linspace(0.5, 15.0, 60)
    states = np.array([lying(pitch) for pitch in rolling])
    assert np.ptp(states[:, 1]) < 2 * np.pi and data.qpos[2] == rolling[-1], "the simulation itself is left alone"
    np.testing.assert_allclose(task.motion(states, 0.1)[0][:, 2], rolling, atol=1e-9)


@pytest.mark.parametrize("name", ["inverted_pendulum", "half_cheetah", "walker2d"])
def test_positions_can_be_told_from_states(name):
    """Exactly where a state has them; the distance along the track from its speed, as well as the period allows."""
    task, rng = make_task(name), np.random.default_rng(0)
    model = task.domain("source").compile()
    data = mujoco.MjData(model)
    task.reset(model, data, rng)
    states, there = [task.state(model, data)], [data.qpos.copy()]
    for _ in range(10):  # a fall comes later, in which speeds change too fast for that
        task.step(model, data, rng.uniform(-1, 1, model.nu) * model.actuator_ctrlrange[:, 1])
        states.append(task.state(model, data))
        there.append(data.qpos.copy())
    there, told = np.array(there), task.motion(np.array(states), task.period(model))[0]
    assert np.array_equal(told[:, 1:], there[:, 1:])
    moved = there[:, 0] - there[0, 0]
    assert np.abs(told[:, 0] - told[0, 0] - moved).max() < 0.25 * np.ptp(moved)


def test_a_task_whose_states_tell_no_positions_says_so():
    with pytest.raises(ValueError, match="fetch_reach"):
        make_task("fetch_reach").motion(np.zeros((2, 16)), 0.04)

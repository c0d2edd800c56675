"""Fetch-Reach and Sawyer-Push against the paper's definitions, worked out by hand."""

import mujoco
import numpy as np
import pytest

from idapt_pl.effects.packaged import ModelsMissing, packaged_file
from idapt_pl.envs import VectorImageEnv
from idapt_pl.tasks import make_task


@pytest.fixture(scope="module")
def play():
    """Plays actions in a domain from a start; returns the environment, to be looked into."""
    made = []

    def play(name, domain, actions, seed=0):
        task = make_task(name)
        env = VectorImageEnv(task, task.domain(domain), 1, 8, 1)
        made.append(env)
        env.reset(seed=seed)
        env.log = [env.step(np.asarray(a, np.float32)[None]) for a in actions]
        return env

    yield play
    for env in made:
        env.close()


def moved(play, domain, action):
    """Where the mocap body is put relative to the hand by one command, m (3,)."""
    task = make_task("fetch_reach")
    env = play("fetch_reach", domain, [])
    data, model = env.data[0], env.model
    hand = data.body("robot0:gripper_link").xpos.copy()
    task.play(model, data, env.domain.command(model, np.asarray([action], float))[0])
    return data.mocap_pos[int(model.body("robot0:mocap").mocapid[0])] - hand


HALF, ROOT3, ROOT2 = 0.5, np.sqrt(3) / 2, np.sqrt(2) / 2


@pytest.mark.parametrize(
    ("domain", "action", "command"),
    [
        ("source", (1, 0, 0, 0), (1, 0, 0)),
        ("source", (0.2, -0.4, 0.6, 1), (0.2, -0.4, 0.6)),
        ("easy", (1, 0, 0, 0), (ROOT3, HALF, 0)),
        ("easy", (0, 1, 0.5, 0), (-HALF, ROOT3, 0.5)),
        ("hard", (1, 0, 0, 0), (ROOT2, ROOT2, -0.5)),
        ("hard", (0, 1, -1, 0), (-ROOT2, ROOT2, -1.5)),
        ("hard", (1, 1, 0.5, 0), (0, np.sqrt(2), 0)),  # beyond the range of an action: nothing clips it after the turn
    ],
)
def test_fetch_commands_are_turned_then_biased_then_scaled_by_5_cm(play, domain, action, command):
    np.testing.assert_allclose(moved(play, domain, action), 0.05 * np.array(command), atol=1e-12)


def test_fetch_actions_beyond_1_are_clipped_before_they_are_turned(play):
    a = play("fetch_reach", "hard", [(9, -9, 9, 0)]).data[0].mocap_pos
    b = play("fetch_reach", "hard", [(1, -1, 1, 0)]).data[0].mocap_pos
    np.testing.assert_array_equal(a, b)


def test_fetch_starts_where_gymnasium_robotics_documents_it(play):
    env = play("fetch_reach", "source", [])
    np.testing.assert_allclose(env.data[0].site("robot0:grip").xpos, (1.3419, 0.7491, 0.5347), atol=2e-4)


def test_fetch_goals_are_in_a_square_of_30_cm_at_a_height_of_45_cm(play):
    env = play("fetch_reach", "source", [])
    goals = np.array([env.reset(seed=k)[0]["state"][0, 3:6] for k in range(200)])
    away = goals[:, :2] - env.data[0].site("robot0:grip").xpos[:2]
    assert np.abs(away).max() <= 0.15 + 1e-6 and np.ptp(away, axis=0).min() > 0.28
    np.testing.assert_allclose(goals[:, 2], 0.45, atol=1e-6)


def test_fetch_reward_is_minus_the_distance_and_success_is_below_5_cm(play):
    task, env = make_task("fetch_reach"), play("fetch_reach", "source", [(0, 0, 0, 0)])
    model, data = env.model, env.data[0]
    goal = int(model.body("goal").mocapid[0])
    for offset, reached in (((0.03, 0.04, 0), False), ((0.03, 0.0399, 0), True), ((0, 0, -0.3), False)):
        data.mocap_pos[goal] = data.site("robot0:grip").xpos + offset
        assert task.outcome(model, data, np.zeros(4)) == (pytest.approx(-np.linalg.norm(offset)), False)
        assert task.success(model, data) == reached


def test_fetch_state_is_gripper_goal_and_gymnasium_robotics_observation(play):
    before = play("fetch_reach", "source", [(0, 0, 0, 0)] * 3 + [(1, 0, 0, 0)] * 2)
    state, data = before.log[-1][0]["state"][0], before.data[0]
    np.testing.assert_allclose(state[:3], state[6:9])
    np.testing.assert_allclose(state[3:6], data.mocap_pos[int(before.model.body("goal").mocapid[0])], atol=1e-6)
    np.testing.assert_array_equal(state[9:11], 0)  # the fingers are blocked
    earlier = before.log[-2][0]["state"][0, :3]
    assert state[11] == pytest.approx(state[0] - earlier[0], rel=0.5), "displacement in a control step, not a speed"
    assert state.shape == (16,) and before.dt == pytest.approx(0.04)


def test_fetch_episodes_last_50_steps_and_success_counts_at_any_time(play):
    env = play("fetch_reach", "source", [(0, 0, 0, 0)] * 50)
    assert [bool(step[3][0]) for step in env.log] == [False] * 49 + [True]
    assert not any(step[2][0] for step in env.log)


def place(env, puck):
    """Put the puck somewhere (x, y); returns task, model and data."""
    data = env.data[0]
    data.joint("puck").qpos[:2] = puck
    mujoco.mj_forward(env.model, data)
    return make_task("sawyer_push"), env.model, data


def test_sawyer_reward_is_the_papers(play):
    env = play("sawyer_push", "source", [(0, 0)] * 2)
    goal = env.data[0].mocap_pos[int(env.model.body("goal").mocapid[0])]
    for offset, reached in (((0.1, 0.0), False), ((-0.036, 0.0481), False), ((-0.036, 0.0479), True)):
        task, model, data = place(env, goal[:2] + offset)
        tips = (data.site("rightEndEffector").xpos + data.site("leftEndEffector").xpos) / 2
        away = np.linalg.norm(data.body("puck").xpos - tips)
        reward, over = task.outcome(model, data, np.zeros(2))
        assert reward == pytest.approx(-0.6 * away - np.hypot(*offset) + 150 * reached)
        assert over == reached == task.success(model, data)


def test_sawyer_hand_moves_about_10_cm_a_command_at_one_height_and_stays_over_the_table(play):
    env = play("sawyer_push", "source", [(0, 0)] * 3)
    start = env.data[0].body("hand").xpos.copy()
    for _ in range(2):
        env.step(np.array([[0, 1]], np.float32))
    env.step(np.zeros((1, 2), np.float32))
    after = env.data[0].body("hand").xpos.copy()
    assert 0.14 < after[1] - start[1] < 0.2 and abs(after[2] - 0.89) < 0.01
    for _ in range(12):
        env.step(np.array([[-1, 1]], np.float32))
    x, y, _ = env.data[0].body("hand").xpos
    assert (x, y) == (pytest.approx(0.26, abs=0.03), pytest.approx(0.4, abs=0.03))


def test_sawyer_pushes_the_puck_and_the_puck_does_not_turn(play):
    to_the_side = [(0, 0), (0, 0), (0, -1), (0, -1), (0, -1)]
    env = play("sawyer_push", "source", to_the_side)
    puck = env.data[0].body("puck")
    assert puck.xpos[1] < -0.05, "the hand started beside it and went through its place"
    np.testing.assert_allclose(puck.xquat, (0.8776, 0, 0, 0.4794), atol=1e-3)


def test_sawyer_state_starts_and_horizon(play):
    env = play("sawyer_push", "source", [])
    states = np.array([env.reset(seed=k)[0]["state"][0] for k in range(100)])
    assert states.shape[1] == 40
    goals, pucks = states[:, 25:28], states[:, 28:31]
    np.testing.assert_allclose(goals.mean(0), (0.76, 0.1, 0.82), atol=0.005)
    np.testing.assert_allclose(goals[:, :2].std(0), 0.02, rtol=0.25)
    np.testing.assert_allclose(states[:, :7].std(0), 0.02, rtol=0.25)
    np.testing.assert_allclose(pucks.std(0), 0, atol=1e-5)
    np.testing.assert_allclose(states[:, 38:40], pucks[:, :2] - goals[:, :2], atol=1e-6)
    assert env.task.horizon == 70 and env.dt == pytest.approx(0.15)


@pytest.mark.parametrize(("domain", "mass"), [("source", 0.01), ("easy", 0.03), ("hard", 0.05)])
def test_puck_mass_is_table_1s(domain, mass):
    assert make_task("sawyer_push").domain(domain).compile().body("puck").mass[0] == pytest.approx(mass)


def test_a_missing_package_is_an_error_that_says_what_to_install():
    with pytest.raises(ModelsMissing, match=r"robots-galore, which is not.*pip install 'idapt\[manipulation\]'"):
        packaged_file("robots-galore", "arm.xml")
    with pytest.raises(ModelsMissing, match="has no file no_such_arm"):
        packaged_file("metaworld", "no_such_arm.xml")

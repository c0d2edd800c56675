"""Environments of Gymnasium on MuJoCo that do more than the usual ones: scale actions, change their model, fail."""

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv

from datamodules.users_error import UsersError
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.tasks import make_task

PLAIN = "gymnasium:InvertedPendulum-v5"


class Scaled(InvertedPendulumEnv):
    """Takes -1 to 1 for the cart's -3 to 3."""

    def __init__(self, power=1, **kwargs):
        super().__init__(**kwargs)
        self.power = power
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def step(self, action):
        return super().step(3.0 * np.sign(action) * np.abs(action) ** self.power)


class Shuffled(InvertedPendulumEnv):
    """Every episode has another pole."""

    def reset_model(self):
        self.model.body_mass[-1] = self.np_random.uniform(3, 8)
        return super().reset_model()


class Failing(InvertedPendulumEnv):
    def __init__(self, **kwargs):
        raise AssertionError


class Falling(Scaled):
    def reset_model(self):
        raise RuntimeError("no floor")


@pytest.fixture(autouse=True, scope="module")
def registered():
    for kind in (Scaled, Shuffled, Failing, Falling):
        gymnasium.register(f"{kind.__name__}-v0", kind, max_episode_steps=100)
    yield
    for kind in (Scaled, Shuffled, Failing, Falling):
        gymnasium.registry.pop(f"{kind.__name__}-v0")


def after(task, command, steps=5, effects=()):
    model = task.domain("source").with_effects(*effects).compile()
    data = mujoco.MjData(model)
    for _ in range(steps):
        task.step(model, data, np.array([command]))
    return np.concatenate([data.qpos, data.qvel]), model.actuator_ctrlrange.tolist()


def test_actions_that_an_environment_scales_are_the_motors_commands_all_the_same():
    """So gains, delays and turned motors mean what they say, and actions are in the motor's unit."""
    for command in (-3.0, 0.7, 2.0):
        (plain, ranges), (scaled, same) = (after(make_task(name), command) for name in (PLAIN, "gymnasium:Scaled-v0"))
        np.testing.assert_allclose(scaled, plain, atol=1e-6)
        assert ranges == same == [[-3.0, 3.0]]
    weak, _ = after(make_task("gymnasium:Scaled-v0"), 2.0, effects=[ActuatorGain("*", 0.5)])
    np.testing.assert_allclose(weak, after(make_task(PLAIN), 1.0)[0], atol=1e-6)


def test_actions_that_become_commands_in_another_way_are_refused():
    with pytest.raises(ValueError, match=r"actions of gymnasium:Scaled-v0 are \[-1.\] to \[1.\], commands \[-3.\]"):
        make_task("gymnasium:Scaled-v0", {"power": 2})


def test_a_model_that_changes_from_episode_to_episode_is_refused():
    with pytest.raises(ValueError, match=r"Shuffled-v0 changes its model where an episode begins \(body_mass\)"):
        make_task("gymnasium:Shuffled-v0")


def test_an_environment_that_fails_says_where_and_with_which_mujoco():
    with pytest.raises(UsersError, match=rf"(?s)Failing-v0: the environment fails with MuJoCo {mujoco.__version__}.*"
                                         r"test_gymnasium_task.py.*AssertionError"):  # fmt: skip
        make_task("gymnasium:Failing-v0")


def test_an_environment_that_fails_when_it_is_tried_shows_its_own_error():
    with pytest.raises(UsersError, match=r"(?s)Falling-v0: the environment fails where it is tried.*no floor"):
        make_task("gymnasium:Falling-v0")

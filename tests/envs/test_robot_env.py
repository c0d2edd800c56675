"""Environments of others as targets: what they show, what they are told, and what is said when they fail."""

import threading
import time

import gymnasium
import numpy as np
import pytest

from idapt_pl.envs import ActionMap, MappedActions, RobotEnv, TargetFailed
from idapt_pl.envs.patient import Patient
from idapt_pl.envs.robot_env import RobotSettings, as_image, looks_like_image
from idapt_pl.rl.collect import collect

BOX, UINT8 = gymnasium.spaces.Box, np.uint8


class Slider(gymnasium.Env):
    """A white square on black that actions push sideways; not MuJoCo's, 24 rows and 40 columns."""

    render_mode = None

    def __init__(self, low=-1.0, high=1.0, nu=1, fails_at=None, observation_space=None):
        self.action_space = BOX(np.full(nu, low, np.float32), np.full(nu, high, np.float32))
        self.observation_space = observation_space or BOX(0, 255, (24, 40, 3), UINT8)
        self.fails_at, self.steps, self.told = fails_at, 0, []

    def picture(self):
        image = np.zeros((24, 40, 3), UINT8)
        x = 8 + int(np.clip(self.x, 0, 20))
        image[8:14, x : x + 6] = 255
        return image

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.t = float(self.np_random.integers(0, 3)), 0
        return self.picture(), {}

    def step(self, action):
        self.steps, self.t = self.steps + 1, self.t + 1
        if self.steps == self.fails_at:
            raise OSError("the cable is loose")
        self.told.append(np.array(action))
        self.x += float(action[0])
        return self.picture(), float(self.x), self.x > 5, False, {"success": self.x > 5}


def robot(env, size=16, stack=2, **settings):
    told = {"name": "slider", "horizon": 100, "period": 0.1} | settings
    return RobotEnv(lambda: env, RobotSettings(**told), size, stack)


def push(value, n=1):
    return np.full((1, n), value, np.float32)


def test_it_is_a_vector_of_one_with_stacked_square_images():
    env = robot(Slider())
    obs, _ = env.reset(seed=0)
    assert obs["pixels"].shape == (1, 2, 16, 16, 3) and obs["pixels"].dtype == UINT8 and env.dt == 0.1
    assert np.array_equal(obs["pixels"][0, 0], obs["pixels"][0, 1]), "the first image fills the stack"
    first = obs["pixels"][0, 1]
    obs, reward, over, cut, infos = env.step(push(1.0))
    assert np.array_equal(obs["pixels"][0, 0], first) and not np.array_equal(obs["pixels"][0, 1], first)
    assert (over[0], cut[0], infos) == (False, False, {}) and reward[0] >= 1.0


def test_the_middle_of_a_wide_image_is_kept():
    """Columns 8 to 31 of 40: the square begins at the left edge and is a quarter of the height."""
    env = robot(Slider(), size=24, stack=1)
    env.reset(seed=0)
    env._robot.x = 0.0
    frame = env.step(push(0.0))[0]["pixels"][0, 0]
    assert np.array_equal(frame, env._robot.picture()[:, 8:32])


def test_an_episode_ends_by_itself_or_at_the_horizon_and_begins_anew_in_the_same_step():
    env = robot(Slider(), horizon=3, success=True)
    env.reset(seed=0)
    ends = [env.step(push(0.0))[2:] for _ in range(3)]
    assert [e[1][0] for e in ends] == [False, False, True] and not any(e[0][0] for e in ends)
    assert "final_obs" in ends[2][2] and ends[2][2]["success"][0] == np.False_
    env = robot(Slider(), success=True)
    env.reset(seed=0)
    for _ in range(9):
        obs, _, over, cut, infos = env.step(push(1.0))
        if over[0]:
            break
    assert (
        over[0]
        and not cut[0]
        and infos["success"][0]
        and not np.array_equal(infos["final_obs"]["pixels"], obs["pixels"])
    )


def test_actions_are_clipped_repeated_and_have_the_robots_shape():
    slider = Slider(low=-0.5, high=0.5)
    env = robot(slider, repeat=3)
    env.reset(seed=0)
    _, reward, *_ = env.step(push(2.0))
    assert len(slider.told) == 3 and np.array_equal(slider.told, np.full((3, 1), 0.5))
    x = slider.x
    assert reward[0] == pytest.approx(3 * x - 0.5 - 1.0)  # rewards of the three positions


class Drawn(Slider):
    """Observations are numbers; the picture is drawn."""

    render_mode = "rgb_array"

    def __init__(self):
        super().__init__(observation_space=BOX(-1, 1, (3,)))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(3, np.float32), {}

    def step(self, action):
        return np.zeros(3, np.float32), *super().step(action)[1:]

    def render(self):
        return self.picture()


def test_where_observations_are_numbers_the_picture_is_drawn():
    env, seen = robot(Drawn(), size=24, stack=1), robot(Slider(), size=24, stack=1)
    assert np.array_equal(env.reset(seed=1)[0]["pixels"], seen.reset(seed=1)[0]["pixels"])


class Several(Slider):
    """Two cameras and the joints."""

    def __init__(self):
        space = gymnasium.spaces.Dict(
            {"front": BOX(0, 255, (24, 40, 3), UINT8), "side": BOX(0, 1, (3, 24, 40)), "joints": BOX(-1, 1, (2,))}
        )
        super().__init__(observation_space=space)

    def reset(self, *, seed=None, options=None):
        image, info = super().reset(seed=seed)
        return {"front": image, "side": np.moveaxis(image, -1, 0) / 255.0, "joints": np.zeros(2)}, info


def test_one_of_several_cameras_is_named_and_floats_with_channels_first_are_images_too():
    with pytest.raises(ValueError, match=r"several images; give target\.pixels one of: front, side"):
        robot(Several())
    front, side = (robot(Several(), size=24, stack=1, pixels=key).reset(seed=0)[0] for key in ("front", "side"))
    assert np.array_equal(front["pixels"], side["pixels"])
    with pytest.raises(ValueError, match="shows no 'top'; it shows: front, joints, side"):
        robot(Several(), pixels="top")


def test_what_cannot_be_seen_or_moved_is_refused():
    with pytest.raises(ValueError, match=r"is str, not a gymnasium\.Env"):
        RobotEnv(lambda: "arm", RobotSettings("arm", 10, 0.1), 16, 1)
    with pytest.raises(ValueError, match="shows no images"):
        robot(Slider(observation_space=BOX(-1, 1, (4,))))
    endless = Slider()
    endless.action_space = BOX(-np.inf, np.inf, (1,))
    with pytest.raises(ValueError, match="finite bounds"):
        robot(endless)
    endless.action_space = gymnasium.spaces.Discrete(3)
    with pytest.raises(ValueError, match="must be a Box"):
        robot(endless)


def test_a_failing_robot_is_named_with_what_it_said():
    env = robot(Slider(fails_at=2))
    env.reset(seed=0)
    env.step(push(0.0))
    with pytest.raises(TargetFailed, match="target slider could not take a step: the cable is loose"):
        env.step(push(0.0))


def test_a_robot_that_hangs_is_not_waited_for():
    class Slow(Slider):
        def step(self, action):
            time.sleep(1.0)

    env = robot(Slow(), patience=0.1)
    env.reset(seed=0)
    with pytest.raises(TargetFailed, match=r"no answer within 0\.1 s\. If it .* --target\.patience 0\.2"):
        env.step(push(0.0))


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (np.zeros((12, 40, 3), UINT8), r"images were \(24, 40, 3\) and are \(12, 40, 3\) now"),
        (np.full((24, 40, 3), np.nan), "float64 that is not within 0 and 1"),
        (np.full((24, 40, 3), 200), "int64 that is not within 0 and 1"),
    ],
)
def test_images_that_change_or_make_no_sense_are_refused(second, message):
    class Odd(Slider):
        def step(self, action):
            return second, 0.0, False, False, {}

    env = robot(Odd())
    env.reset(seed=0)
    with pytest.raises(TargetFailed, match=message):
        env.step(push(0.0))


def test_a_person_is_waited_for(monkeypatch):
    asked = []
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text))
    env = robot(Slider(), attended=True, horizon=2)
    env.reset(seed=0)
    for _ in range(2):
        env.step(push(0.0))
    assert len(asked) == 2 and "Reset slider by hand" in asked[0]
    env.reset(seed=1)
    assert len(asked) == 2, "the episode that has just begun is gone on with"
    env.step(push(0.0))
    env.reset(seed=1)
    assert len(asked) == 3


def answering_once(monkeypatch, stop):
    """A person who answers once and then stops; more answers may be added to what this returns."""
    answers = [""]

    def answer(text):
        if not answers:
            raise stop
        return answers.pop()

    monkeypatch.setattr("builtins.input", answer)
    return answers


@pytest.mark.parametrize("stop", [EOFError(), KeyboardInterrupt()])
def test_a_step_that_ends_an_episode_is_told_of_before_the_reset_that_fails(monkeypatch, stop):
    """So it is recorded and counted; what stopped the robot comes with the next call."""
    answers = answering_once(monkeypatch, stop)
    kept, expected = [], KeyboardInterrupt if isinstance(stop, KeyboardInterrupt) else TargetFailed
    env = robot(Slider(), attended=True, horizon=2)
    with pytest.raises(expected):
        collect(env, lambda pixels: push(0.5), 4, 0, "slider", keep=kept.append)
    assert [len(episode) for episode in kept] == [2]
    answers.append("")
    assert env.reset(seed=0)[0]["pixels"].any()  # and it can be gone on with
    env.step(push(0.0))
    env.step(push(0.0))
    if expected is KeyboardInterrupt:
        with pytest.raises(KeyboardInterrupt):
            env.close()  # nobody needs a new episode, but a person wants to stop
    else:
        env.close()


@pytest.mark.parametrize("stop", [EOFError(), KeyboardInterrupt()])
def test_what_was_taken_before_the_reset_at_a_horizon_fails_is_kept(monkeypatch, stop):
    answering_once(monkeypatch, stop)
    kept, env = [], robot(Slider(), attended=True)
    with pytest.raises(KeyboardInterrupt if isinstance(stop, KeyboardInterrupt) else TargetFailed):
        collect(env, lambda pixels: push(0.1), 6, 0, "slider", keep=kept.append, horizon=3)
    assert [len(episode) for episode in kept] == [3]


def test_a_robot_is_closed_whatever_a_person_stopped(monkeypatch):
    class Motors(Slider):
        off = False

        def close(self):
            self.off = True

    def leave(text):
        raise KeyboardInterrupt

    motors = Motors()
    env = robot(motors, attended=True, horizon=1)
    monkeypatch.setattr("builtins.input", lambda text: "")
    env.reset(seed=0)
    monkeypatch.setattr("builtins.input", leave)
    env.step(push(0.0))
    with pytest.raises(KeyboardInterrupt):
        env.close()
    assert motors.off


def test_an_answer_that_nobody_waited_for_is_not_that_of_the_next_call(monkeypatch):
    ask = Patient()
    with pytest.raises(TimeoutError):
        ask(lambda: time.sleep(0.2) or "late", seconds=0.01)
    assert ask(lambda: "next", seconds=5) == "next"


def test_an_attended_robot_with_nobody_there_is_one_sentence(monkeypatch):
    def nobody(text):
        raise EOFError

    monkeypatch.setattr("builtins.input", nobody)
    with pytest.raises(TargetFailed, match="nobody is there"):
        robot(Slider(), attended=True).reset(seed=0)


def test_what_one_thread_made_it_goes_on_with():
    ask = Patient()
    assert ask(threading.get_ident, seconds=5) == ask(threading.get_ident, seconds=5) != threading.get_ident()
    with pytest.raises(KeyError):
        ask({}.__getitem__, "x", seconds=5)


@pytest.mark.parametrize("shape", [(24, 40), (24, 40, 1), (1, 24, 40)])
def test_grey_images_are_images(shape):
    image = as_image(np.full(shape, 7, UINT8))
    assert image.shape == (24, 40, 3) and (image == 7).all()


def test_what_is_said_of_opacity_is_left_out():
    image = np.random.default_rng(0).integers(0, 256, (24, 40, 4), UINT8)
    assert np.array_equal(as_image(image), image[..., :3])
    assert looks_like_image((24, 40, 4)) and not looks_like_image((24, 40, 5))


@pytest.mark.parametrize(
    ("method", "told", "message"),
    [
        ("step", (np.zeros((24, 40, 3), UINT8), 0.0, False, {}), "its step returned 4 values; expected 5"),
        ("step", None, "its step returned NoneType; expected 5"),
        ("reset", np.zeros((24, 40, 3), UINT8), "its reset returned ndarray; expected 2.*observation, info"),
    ],
)
def test_environments_of_before_gymnasium_are_told_what_is_expected(monkeypatch, method, told, message):
    env = robot(Slider())
    if method == "step":
        env.reset(seed=0)
    monkeypatch.setattr(env._robot, method, lambda *args, **kwargs: told)
    with pytest.raises(TargetFailed, match=message):
        env.step(push(0.0)) if method == "step" else env.reset(seed=0)


# --- actions in other words -----------------------------------------------------------------------------


def mapped(low, high, theirs=(-1.0, 1.0), nu=2, **how):
    slider = Slider(*theirs, nu=nu)
    env = MappedActions(robot(slider), ActionMap.from_config(how, np.asarray(low, float), np.asarray(high, float)))
    env.reset(seed=0)
    return env, slider


def test_actions_keep_the_sources_bounds_and_arrive_in_the_targets_order_and_units():
    env, slider = mapped([-3, -5], [3, 5], order=[1, 0], scale=[0.2, -0.3], offset=[0.0, 0.1])
    assert np.array_equal(env.single_action_space.high, [3, 5])
    env.step(np.array([[1.0, 2.0]], np.float32))
    np.testing.assert_allclose(slider.told[-1], [0.4, -0.2], atol=1e-6)
    there = env._to_target(np.array([[1.0, 2.0], [-3.0, 5.0]], np.float32))
    np.testing.assert_allclose(env._to_target.back(there), [[1.0, 2.0], [-3.0, 5.0]], atol=1e-6)
    np.testing.assert_allclose(env._to_target.ends, [[-1.0, -0.8], [1.0, 1.0]], atol=1e-6)


def test_like_actions_need_no_map():
    env, slider = mapped([-1, -1], [1, 1])
    env.step(np.array([[0.3, -0.4]], np.float32))
    np.testing.assert_allclose(slider.told[-1], [0.3, -0.4], atol=1e-6)


@pytest.mark.parametrize(
    ("bounds", "how", "message"),
    [
        (([-3, -3], [3, 3]), {}, r"scale: \[0\.333333, 0\.333333\], offset: \[0\.0, 0\.0\]"),
        (([-1, -1, -1], [1, 1, 1]), {}, "the target has 2 actions and the source 3"),
        (([-1, -1], [1, 1]), {"order": [0, 0]}, "each of the numbers 0 to 1 must be there once"),
        (([-1, -1], [1, 1]), {"scale": [1, 2, 3]}, r"target\.actions\.scale is \[1, 2, 3\]; give 2 numbers"),
        (([-1, -1], [1, 1]), {"scale": "big"}, "give 2 numbers"),
        (([-1, -1], [1, 1]), {"scale": [1, 0]}, "with 0 an action would do nothing"),
        (([-1, -1], [1, 1]), {"offset": [0, float("nan")]}, "give 2 numbers"),
        (([-1, -1], [1, 1]), {"sign": -1}, "has sign; it takes order, scale and offset"),
    ],
)
def test_maps_that_cannot_be_are_refused_with_what_to_write(bounds, how, message):
    with pytest.raises(ValueError, match=message):
        mapped(*bounds, **how)

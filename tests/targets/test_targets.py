"""Targets that are none of the task's domains, from what a config says of them to whole (tiny) runs."""

import json
from contextlib import closing
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import yaml
from conftest import tiny_config

from cli.main import main
from datamodules import read_trajectories
from idapt_pl.envs import TargetFailed
from idapt_pl.envs.robot_env import RobotEnv, RobotSettings
from idapt_pl.evaluation.video import record_video
from idapt_pl.rl.returns import evaluate
from idapt_pl.targets import Look, OtherTaskTarget, RobotTarget, make_target, target_name
from idapt_pl.tasks import make_task

LOOK = Look(image_size=16, frame_stack=2)

LAB = '''
"""A cart and its pole that nobody's physics engine knows: small Euler steps, a drawn picture."""

import os

import gymnasium
import numpy as np


class CartPole(gymnasium.Env):
    dt = 0.04
    render_mode = None
    action_space = gymnasium.spaces.Box(-3, 3, (1,))
    observation_space = gymnasium.spaces.Box(0, 255, (40, 40, 3), np.uint8)

    def __init__(self, length=0.6):
        self.length = length

    def picture(self):
        image = np.full((40, 40, 3), (90, 120, 90), np.uint8)
        column = int(np.clip(20 + 12 * self.x, 3, 36))
        image[30:34, column - 3 : column + 4] = 20
        for reach in np.linspace(0, 14, 30):
            row, col = int(30 - reach * np.cos(self.angle)), int(column + reach * np.sin(self.angle))
            image[np.clip(row, 0, 39), np.clip(col, 0, 39)] = 240
        return image

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.v, self.w = 0.0, 0.0, 0.0
        self.angle = float(self.np_random.uniform(-0.02, 0.02))
        return self.picture(), {}

    def step(self, action):
        if os.path.exists("unplugged"):
            with open("unplugged") as file:
                left = int(file.read())
            if left == 0:
                raise ConnectionError("no answer from the cart")
            with open("unplugged", "w") as file:
                file.write(str(left - 1))
        for _ in range(8):
            force = 150 * float(action[0])
            self.v += 0.005 * force / 10
            self.w += 0.005 * (9.81 * np.sin(self.angle) - force / 10 * np.cos(self.angle)) / self.length
            self.x, self.angle = self.x + 0.005 * self.v, self.angle + 0.005 * self.w
        fallen = abs(self.angle) > 0.2
        return self.picture(), float(not fallen), fallen, False, {}


class Steady(CartPole):
    """Not over before its horizon, whatever a policy does that has learned nothing."""

    def step(self, action):
        picture, reward, _, over, told = super().step(action)
        return picture, reward, False, over, told


def slow() -> gymnasium.Env:
    env = CartPole()
    env.dt = 0.1
    return env


def unsaid():
    raise AssertionError("called")
'''


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with the user's module, from which commands are given."""
    (tmp_path / "my_lab.py").write_text(LAB)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def written(folder, **target):
    """A config for a tiny run to a target; keys with dots are made nested."""
    config = tiny_config(target=target)
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(config))
    return path


@pytest.mark.usefixtures("lab")
def test_a_run_to_somebody_elses_environment_that_fails_in_the_middle_and_goes_on(tmp_path, capsys):
    config, run = written(tmp_path, env="my_lab:CartPole", name="lab cart", options={"length": 0.5}), tmp_path / "run"
    command = ["fit", "--config", str(config), "--run_dir", str(run)]
    (tmp_path / "unplugged").write_text("25")
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "target lab cart could not take a step: no answer from the cart. 25 of 60 control steps" in said
    assert "Traceback" not in said and json.loads((run / "ledger.json").read_text())["training_total"] == 25
    kept = [e for f in sorted((run / "step_00/target_parts").glob("*.h5")) for e in read_trajectories(f)]
    (tmp_path / "unplugged").unlink()
    (run / "ledger.json").unlink()  # it comes back from the parts

    assert main(command) == 0
    recorded = list(read_trajectories(run / "step_00/target.h5"))
    assert not (run / "step_00/target_parts").exists() and sum(map(len, recorded)) == 60
    for before, now in zip(kept, recorded, strict=False):
        np.testing.assert_array_equal(before.observations["pixels"], now.observations["pixels"])
        np.testing.assert_array_equal(before.actions, now.actions)
    for episode in recorded:
        assert set(episode.observations) == {"pixels"} and episode.rewards is None
        assert episode.observations["pixels"].shape[1:] == (32, 32, 3)

    summary = json.loads((run / "summary.json").read_text())
    assert (summary["target"], summary["target_interactions"]) == ("lab cart", 120)
    assert (summary["direct_transfer"], summary["visual_only"], summary["grounded"]) == (None, None, [None])
    assert {e["purpose"] for e in json.loads((run / "ledger.json").read_text())["entries"] if e["count"]} == {
        "training"
    }
    page = (run / "report.html").read_text()
    assert "the target is not measured" in page and "target (right" not in page and "same states" not in page
    assert main(["ledger", "--run", str(run)]) == 0
    assert main(["evaluate", "--run", str(run), "--episodes", "1"]) == 1
    assert "the target lab cart is not measured" in capsys.readouterr().err


@pytest.mark.usefixtures("lab")
def test_returns_are_reported_where_the_user_says_so(tmp_path, capsys):
    run = tmp_path / "run"
    config = written(tmp_path, env="my_lab:CartPole", measure=True, horizon=30)
    assert main(["fit", "--config", str(config), "--run_dir", str(run), "--schedule.grounding_steps", "0"]) == 0
    summary = json.loads((run / "summary.json").read_text())
    assert 0 < summary["direct_transfer"] <= 30 and 0 < summary["visual_only"] <= 30
    result = json.loads((run / "step_00/evaluation.json").read_text())
    assert result["translation"] == {} and result["target"]["state_errors"] == {}
    purposes = {e["purpose"]: e["count"] for e in json.loads((run / "ledger.json").read_text())["entries"]}
    assert purposes["training"] == 60 and purposes["evaluation"] == result["target"]["interactions"] + 75
    capsys.readouterr()
    assert main(["evaluate", "--run", str(run), "--episodes", "2", "--json"]) == 0
    policies = json.loads(capsys.readouterr().out)["policies"]
    assert 0 < policies["visual grounding, step 0"]["target"]["mean"] <= 30


@pytest.mark.usefixtures("lab")
def test_how_long_is_waited_and_whether_it_is_measured_may_be_changed_when_a_run_goes_on(tmp_path, capsys):
    run, config = tmp_path / "run", written(tmp_path, env="my_lab:CartPole", horizon=30)
    (tmp_path / "unplugged").write_text("25")
    assert main(["fit", "--config", str(config), "--run_dir", str(run), "--schedule.grounding_steps", "0"]) == 1
    (tmp_path / "unplugged").unlink()
    resume = ["fit", "--config", str(run / "config.yaml"), "--target.patience", "60"]
    capsys.readouterr()
    assert main([*resume, "--target.horizon", "20"]) == 1
    assert "another config (target.horizon differ)" in capsys.readouterr().err
    assert main(resume) == 0
    assert main(["evaluate", "--run", str(run), "--episodes", "1"]) == 1
    told = capsys.readouterr().err
    command = f"fit --config {run / 'config.yaml'} --target.measure true"
    assert command in told and main(command.split()) == 0
    assert yaml.safe_load((run / "config.yaml").read_text())["target"]["patience"] == 60
    assert json.loads((run / "summary.json").read_text())["visual_only"] is None
    assert main(["evaluate", "--run", str(run), "--episodes", "1", "--json"]) == 0
    assert main(["ledger", "--run", str(run)]) == main(["report", "--run", str(run)]) == 0


@pytest.mark.usefixtures("lab")
def test_a_person_judges_and_nothing_that_was_judged_is_lost_when_the_robot_fails(tmp_path, capsys, monkeypatch):
    asked: list[str] = []

    def answer(text):
        asked.append(text)
        return "what?" if len(asked) == 1 else "2.5"

    monkeypatch.setattr("builtins.input", answer)
    run = tmp_path / "run"
    config = written(tmp_path, env="my_lab:Steady", name="lab cart", measure="ask", horizon=8)
    command = ["fit", "--config", str(config), "--run_dir", str(run), "--schedule.grounding_steps", "0"]
    command += ["--episodes", "3", "--side_by_side", "true"]  # which must not be: there is one robot
    (tmp_path / "unplugged").write_text("70")  # 60 are recorded; one episode of 8, and two steps
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "1 of 3 episodes of direct transfer, step 0, are kept" in said and len(asked) == 2
    assert all("An episode of lab cart is over. What was its return" in text for text in asked)

    def counted(purpose):
        entries = json.loads((run / "ledger.json").read_text())["entries"]
        return sum(e["count"] for e in entries if e["purpose"] == purpose)

    assert counted("training") == 60 and counted("evaluation of direct transfer") == 10
    (run / "ledger.json").unlink()
    assert main(["ledger", "--run", str(run), "--repair"]) == 0
    assert counted("training") == 60 and counted("evaluation of direct transfer") == 10

    (tmp_path / "unplugged").write_text("1000")
    assert main(command) == 0
    result = json.loads((run / "step_00/direct_transfer.json").read_text())
    assert (result["returns"], len(asked)) == ([2.5] * 3, 2 + 2 + 3)
    assert not list(run.rglob("*_so_far.json"))
    played = 1000 - int((tmp_path / "unplugged").read_text())
    assert counted("evaluation of direct transfer") + counted("evaluation") == 10 + played
    assert main(["ledger", "--run", str(run)]) == 0


@pytest.mark.usefixtures("lab")
def test_what_was_judged_of_a_correspondence_is_kept_too_when_the_robot_fails(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("builtins.input", lambda text: "2.5")
    run = tmp_path / "run"
    config = written(tmp_path, env="my_lab:Steady", name="lab cart", measure="ask", horizon=8)
    command = ["fit", "--config", str(config), "--run_dir", str(run), "--schedule.grounding_steps", "0"]
    command += ["--episodes", "3", "--method", "cc_image"]
    (tmp_path / "unplugged").write_text("94")  # 60 are recorded, 24 direct transfer; one episode of 8, two steps
    assert main(command) == 1
    assert "1 of 3 episodes of evaluation, step 0, are kept" in capsys.readouterr().err

    before = {"training": 60, "evaluation of direct transfer": 24}

    def counted():
        entries = json.loads((run / "ledger.json").read_text())["entries"]
        return {e["purpose"]: e["count"] for e in entries if e["count"]}

    assert counted() == before | {"evaluation": 10}
    (tmp_path / "unplugged").write_text("1000")
    assert main(command) == 0
    result = json.loads((run / "step_00/evaluation.json").read_text())["target"]
    played = 1000 - int((tmp_path / "unplugged").read_text())
    assert result["returns"] == [2.5] * 3 and counted() == before | {"evaluation": 10 + played}
    assert not list(run.rglob("*_so_far.json")) and main(["ledger", "--run", str(run)]) == 0


def test_a_video_ends_where_the_robot_fails_and_says_how_far_it_came():
    class Failing:
        def __init__(self, fails_at):
            self.fails_at, self.steps = fails_at, 0

        def reset(self, seed=None):
            return {"pixels": np.zeros((1, 2, 8, 8, 3), np.uint8)}, {}

        def step(self, actions):
            self.steps += 1
            if self.steps == self.fails_at:
                raise TargetFailed("the cable is loose")
            never = np.zeros(1, bool)
            return {"pixels": np.full((1, 2, 8, 8, 3), self.steps, np.uint8)}, np.zeros(1), never, never, {}

    act = lambda pixels: np.zeros((1, 1), np.float32)  # noqa: E731
    frames, taken = record_video(Failing(4), act, 10, 0)
    assert taken == 3 and frames[:, 0, 0, 0].tolist() == [0, 1, 2, 3]
    frames, taken = record_video(Failing(0), act, 10, 0)
    assert taken == 10 and frames[:, 0, 0, 0].tolist() == list(range(10))


@pytest.mark.slow
@pytest.mark.usefixtures("lab")
def test_what_was_judged_later_is_kept_too_when_the_robot_fails(tmp_path, capsys, monkeypatch):
    answers: list[str] = []
    monkeypatch.setattr("builtins.input", lambda text: answers.append(text) or str(len(answers)))
    run = tmp_path / "run"
    config = written(tmp_path, env="my_lab:CartPole", measure="ask", horizon=8)
    fit = ["fit", "--config", str(config), "--run_dir", str(run), "--schedule.grounding_steps", "0", "--episodes", "1"]
    assert main(fit) == 0
    answers.clear()
    command = ["evaluate", "--run", str(run), "--episodes", "3", "--seed", "5", "--json"]
    (tmp_path / "unplugged").write_text("34")  # three episodes of at most 8, and a part of what the next policy does
    assert main(command) == 1
    assert "1 of 3 episodes of visual grounding, step 0 are kept" in capsys.readouterr().err and len(answers) == 4

    def counted():
        entries = json.loads((run / "ledger.json").read_text())["entries"]
        return {e["purpose"].split(",")[0]: e["count"] for e in entries if "seed 5" in e["purpose"]}

    so_far = counted()
    assert set(so_far) == {"evaluation of direct transfer", "evaluation of visual grounding"}
    assert sum(so_far.values()) == 34 and so_far["evaluation of visual grounding"] > 8
    (run / "ledger.json").unlink()
    assert main(["ledger", "--run", str(run), "--repair"]) == 0 and counted() == so_far

    (tmp_path / "unplugged").write_text("1000")
    capsys.readouterr()
    assert main(command) == 0
    policies = json.loads(capsys.readouterr().out)["policies"]
    assert policies["direct transfer"]["target"]["returns"] == [1, 2, 3]
    assert policies["visual grounding, step 0"]["target"]["returns"] == [4, 5, 6]
    played = 1000 - int((tmp_path / "unplugged").read_text())
    assert counted() == so_far | {"evaluation of visual grounding": so_far["evaluation of visual grounding"] + played}
    assert not list(run.glob("*_so_far.json")) and main(["ledger", "--run", str(run)]) == 0


@pytest.mark.usefixtures("lab")
def test_a_person_who_is_asked_for_success_says_yes_or_no(monkeypatch):
    answers = iter(["perhaps", "Y", "no"])
    monkeypatch.setattr("builtins.input", lambda text: next(answers))
    target = make_target({"env": "my_lab:CartPole", "measure": "ask", "horizon": 2}, make_task("inverted_pendulum"))
    target = replace(target, settings=replace(target.settings, success=True))
    with closing(target.with_reward(1, LOOK)) as env:
        result = evaluate(env, lambda pixels: np.zeros((1, 1), np.float32), 2, seed=0)
    assert result.successes == (True, False) and result.mean == 0.5
    with closing(target.with_reward(1, LOOK, asking=False)) as env:
        assert evaluate(env, lambda pixels: np.zeros((1, 1), np.float32), 2, seed=0).successes == (False, False)


def test_another_tasks_simulation_is_a_target_whose_states_and_model_stay_unknown():
    task = make_task("gymnasium:InvertedPendulum-v5")
    said = {"task": "dm_control:cartpole/balance", "options": {"action_repeat": 4}, "actions": {"scale": 1 / 3}}
    target = make_target(said, task)
    assert isinstance(target, OtherTaskTarget) and target.measured and target.posable_twin(LOOK) is None
    env = target.with_reward(2, LOOK)
    obs, _ = env.reset(seed=0)
    assert set(obs) == {"pixels"} and obs["pixels"].shape == (2, 2, 16, 16, 3)
    _, reward, *_ = env.step(np.zeros((2, 1), np.float32))
    assert (reward > 2).all(), "the suite's reward, four of its steps near the upright"
    assert np.array_equal(env.single_action_space.high, [3.0])
    env.close()


def test_gymnasiums_environments_without_mujoco_are_targets():
    pytest.importorskip("pygame")
    task = make_task("dm_control:pendulum/swingup", {"action_repeat": 5, "expert_steps": 100})
    said = {"env": "gymnasium:Pendulum-v1", "repeat": 2, "actions": {"scale": 2.0}, "measure": True}
    env = make_target(said, task).with_reward(1, LOOK)
    first = env.reset(seed=0)[0]["pixels"]
    obs, reward, *_ = env.step(np.ones((1, 1), np.float32))
    env.close()
    assert not np.array_equal(obs["pixels"][0, 1], first[0, 1]) and reward[0] < 0


SOURCE = "gymnasium:InvertedPendulum-v5"


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("medium", "has no domain 'medium'; it has: source"),
        ({}, "give the name of a domain, or one of env, task"),
        ({"env": "my_lab:CartPole", "task": "walker2d"}, "one of env, task"),
        ({"env": "my_lab:CartPole", "speed": 3}, r"target\.speed: unknown with target\.env; there are: actions"),
        ({"task": "walker2d", "horizon": 3}, r"target\.horizon: unknown with target\.task"),
        ({"env": "my_lab:CartPole", "repeat": 0}, r"target\.repeat"),
        ({"env": "my_lab:CartPole", "patience": "long"}, "give a number"),
        ({"env": "my_lab:CartPole", "options": 3}, "give keys and values"),
        ({"task": "no_such_task"}, "unknown task 'no_such_task'"),
        ({"task": "dm_control:cartpole/balance"}, r"0\.01 s long, the source's 0\.04 s.*action_repeat"),
        ({"env": "my_lab:Nothing"}, "my_lab has no 'Nothing'"),
        ({"env": "my_lab:slow"}, r"0\.1 s long, the source's 0\.04 s.*target\.repeat"),
        ({"env": "my_lab:unsaid"}, r"not said to return gymnasium\.Env.*write `def unsaid\(\.\.\.\) -> Env:`"),
        ({"env": "os:system", "options": {"command": "true"}}, "os is a module of Python itself"),
        ({"env": "gymnasium:antigravity:Arm-v0"}, "antigravity is a module of Python itself"),
        ({"env": "my_lab:CartPole", "options": {"weight": 3}}, "(?s)Traceback.*weight"),
        ({"env": "gymnasium:Nope-v0"}, "Nope"),
    ],
)
def test_descriptions_that_make_no_sense_are_refused(said, message):
    with pytest.raises((ValueError, RuntimeError), match=message):
        make_target(said, make_task(SOURCE)).with_reward(1, LOOK)


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize(
    ("target", "told"),
    [
        ({"env": "gymnasium:Nope-v0"}, "Nope"),
        ({"env": "my_lab:Nothing"}, "my_lab has no 'Nothing'"),
        ({"env": "no_lab:CartPole"}, "no_lab"),
    ],
)
def test_a_target_that_is_not_there_is_missed_before_anything_trains(target, told, tmp_path, capsys):
    config = written(tmp_path, **target)
    assert main(["fit", "--config", str(config), "--run_dir", str(tmp_path / "run")]) == 1
    assert told in capsys.readouterr().err
    assert not list((tmp_path / "run").glob("step_*"))


@pytest.mark.usefixtures("lab")
def test_looking_for_a_robot_neither_makes_nor_moves_it():
    """It may need a person; a registered environment is a simulation, and is drawn."""

    def boom() -> None:
        raise AssertionError("made")

    robot = make_target({"env": "my_lab:CartPole"}, make_task(SOURCE))
    replace(robot, make=boom).look_for(LOOK)
    simulation = make_target({"env": "gymnasium:CartPole-v1"}, make_task(SOURCE))
    with pytest.raises(RuntimeError, match="could not be made: made"):
        replace(simulation, make=boom).look_for(LOOK)


@pytest.mark.usefixtures("lab")
def test_a_config_that_was_refused_before_anything_was_done_may_be_corrected(tmp_path, capsys):
    args = ["--run_dir", str(tmp_path / "run")]
    assert main(["fit", "--config", str(written(tmp_path, env="my_lab:CartPole", pixels="front")), *args]) == 1
    assert "holds a run with another config" not in capsys.readouterr().err
    assert main(["fit", "--config", str(written(tmp_path, env="my_lab:Nope")), *args]) == 1
    told = capsys.readouterr().err
    assert "my_lab has no 'Nope'" in told and "another config" not in told


def test_rewards_that_nobody_reads_may_be_anything_and_measured_ones_are_numbers():
    class Odd(gymnasium.Env):
        action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
        observation_space = gymnasium.spaces.Box(0, 255, (20, 20, 3), np.uint8)

        def reset(self, *, seed=None, options=None):
            return self.observation_space.sample(), {}

        def step(self, action):
            return self.observation_space.sample(), self.reward, False, False, {}

    fine, wrong = ((None, False), (np.nan, False), (np.array([2.0]), True)), ((None, True), (np.nan, True))
    for reward, measured in (*fine, *wrong):
        robot = RobotEnv(Odd, RobotSettings("odd", 10, 0.1, rewarded=measured), 16, 2)
        robot._robot.reward = reward
        robot.reset()
        if (reward, measured) in wrong:
            with pytest.raises(TargetFailed, match=r"gives the reward .*; expected a finite number"):
                robot.step(np.zeros((1, 1)))
        else:
            assert robot.step(np.zeros((1, 1)))[1] == (2.0 if measured else 0.0)
        robot.close()


@pytest.mark.usefixtures("lab")
def test_an_oracle_needs_states_of_the_target(tmp_path, capsys):
    config = written(tmp_path, env="my_lab:CartPole")
    assert main(["fit", "--config", str(config), "--run_dir", str(tmp_path / "run"), "--oracle", "true"]) == 1
    assert "oracle: it would train on the states of my_lab:CartPole" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_targets_have_names_for_folders():
    assert target_name("hard") == "hard" and target_name({"env": "a:b"}) == "a:b"
    assert target_name({"env": "a:b", "name": "arm 3"}) == "arm 3"
    assert isinstance(make_target({"env": "my_lab:CartPole"}, make_task(SOURCE)), RobotTarget)

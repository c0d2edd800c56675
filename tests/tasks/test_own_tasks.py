"""Tasks made of environments of others, and of the user's own modules."""

import gc
import os
import shlex
import subprocess
import sys
import weakref
from contextlib import closing
from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest
import yaml
from conftest import ROOT
from dm_control import suite

from cli.main import main
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.effects.joints import JointArmature
from idapt_pl.envs import VectorImageEnv
from idapt_pl.tasks import Task, make_task, robot_spec
from idapt_pl.tasks.environment_task import EnvironmentTask

PAGE = (ROOT / "docs/guide/own_robot.md").read_text()
BLOCKS = [part.split("\n", 1) for part in PAGE.split("```")[1::2]]
"""Kind and text of each block of code of the guide."""

URDF = next(text for kind, text in BLOCKS if kind == "xml")
NAMED = {text.split()[1]: text for kind, text in reversed(BLOCKS) if kind in ("python", "yaml") and text[:2] == "# "}
FILES = {"arm.urdf": URDF} | {name: NAMED[name] for name in ("my_robot.py", "my_lab.py", "my.yaml")}
GUIDE = FILES["my_robot.py"]
"""The user's own robot, as the guide has it: a URDF, a motor, a camera and a reward, a lab and a config."""

COMMANDS = [line for kind, text in BLOCKS if kind == "bash" for line in text.splitlines() if line.startswith("idapt ")]

MODULE = (
    GUIDE
    + """

class Arm(Reach):
    def __init__(self, goal=1.0):
        self.goal = goal

    def outcome(self, model, data, action):
        return -abs(float(data.qpos[0]) - self.goal), False


class Wrong(Arm):
    def __init__(self, how):
        super().__init__()
        self.how = how
        if how == "no steps":
            self.frame_skip = 0

    def base(self):
        spec = super().base()
        if self.how == "a path":
            return "arm.urdf"
        if self.how == "no camera":
            spec.camera("view").name = "front"
        if self.how == "no range":
            spec.actuators[0].ctrllimited = 0
        return spec

    def reset(self, model, data, rng):
        data.qpos[:] = [1, 2, 3] if self.how == "start" else 0.1

    def state(self, model, data):
        found = super().state(model, data)
        return {"square": np.ones((2, 3)), "nan": found * np.nan}.get(self.how, found)

    def outcome(self, model, data, action):
        made = super().outcome(model, data, action)
        wrong = {"alone": 1.0, "array": (np.ones(2), False), "no number": (np.nan, False), "why": (1.0, "fallen")}
        return wrong.get(self.how, made)


def seven() -> Task:
    return 7


def fails(**options) -> Task:
    raise RuntimeError(f"no robot on {options['port']}")


def silent():
    raise AssertionError("called")


def told(goal: "nothing that is there") -> "Reach":
    return Arm(goal)


def another() -> int:
    raise AssertionError("called")


class NoTask:
    def __init__(self):
        raise AssertionError("called")
"""
)


def played(task, domain, rng, actions):
    """States, rewards and ends of a task under the given actions."""
    model = domain.compile()
    data = mujoco.MjData(model)
    task.reset(model, data, rng)
    mujoco.mj_forward(model, data)
    states, outcomes = [task.state(model, data)], []
    for action in actions:
        outcomes.append(task.step(model, data, action))
        states.append(task.state(model, data))
    return np.array(states), np.array(outcomes, float)


def reference(env, seed, actions):
    """The same of a Gymnasium environment."""
    states, outcomes = [env.reset(seed=seed)[0]], []
    for action in actions:
        state, reward, over, *_ = env.step(action)
        states.append(state)
        outcomes.append((reward, over))
    return np.array(states), np.array(outcomes, float)


@pytest.mark.parametrize("name", ["HalfCheetah-v5", "Hopper-v5", "Reacher-v5"])
def test_gymnasiums_environments_are_reproduced_to_the_bit(name):
    env, task = gymnasium.make(name).unwrapped, make_task(f"gymnasium:{name}")
    actions = np.random.default_rng(1).uniform(-1, 1, (40, env.model.nu)).astype(np.float32)
    expected = reference(env, 3, actions)
    got = played(task, task.domain("source"), gymnasium.utils.seeding.np_random(3)[0], actions)
    np.testing.assert_array_equal(got[0], expected[0])
    np.testing.assert_array_equal(got[1], expected[1])
    assert name != "Hopper-v5" or expected[1][:, 1].any(), "it must fall for ends to be compared"
    assert task.horizon == gymnasium.spec(name).max_episode_steps


def test_an_environment_goes_on_with_the_repaired_model():
    """Effects of a domain do to Gymnasium's environment what the same change of its model does."""
    env, task = gymnasium.make("HalfCheetah-v5").unwrapped, make_task("gymnasium:HalfCheetah-v5")
    domain = task.domain("source").with_effects(JointArmature("bthigh", 0.7))
    env.model.dof_armature[env.model.joint("bthigh").dofadr] = 0.7
    mujoco.mj_setConst(env.model, env.data)
    actions = np.random.default_rng(1).uniform(-1, 1, (20, env.model.nu)).astype(np.float32)
    changed = played(task, domain, gymnasium.utils.seeding.np_random(3)[0], actions)[0]
    plain = played(task, task.domain("source"), gymnasium.utils.seeding.np_random(3)[0], actions)[0]
    np.testing.assert_allclose(changed, reference(env, 3, actions)[0], atol=1e-9)
    assert np.abs(changed - plain).max() > 0.1


@pytest.mark.parametrize("name", ["cartpole/swingup", "cheetah/run", "walker/walk"])
def test_dm_controls_tasks_are_reproduced(name):
    task, rng = make_task(f"dm_control:{name}"), np.random.default_rng(3)
    random = np.random.RandomState(np.random.default_rng(3).integers(2**31))
    env = suite.load(*name.split("/"), task_kwargs={"random": random})
    actions = np.random.default_rng(1).uniform(-1, 1, (30, env.action_spec().shape[0]))
    steps = [env.reset(), *(env.step(action) for action in actions)]
    expected = np.array([np.concatenate([np.ravel(part) for part in s.observation.values()]) for s in steps])
    states, outcomes = played(task, task.domain("source"), rng, actions)
    np.testing.assert_allclose(states, expected, atol=1e-8)
    np.testing.assert_allclose(outcomes[:, 0], [s.reward for s in steps[1:]], atol=1e-8)
    assert np.abs(states[-1] - states[0]).max() > 0.05
    assert task.period(task.domain("source").compile()) == pytest.approx(env.control_timestep())


def test_rewards_of_repeated_actions_are_summed_and_the_horizon_is_as_long_in_seconds():
    once, thrice = make_task("gymnasium:Swimmer-v5"), make_task("gymnasium:Swimmer-v5", {"action_repeat": 3})
    actions = np.random.default_rng(1).uniform(-1, 1, (4, 2))
    rng = [gymnasium.utils.seeding.np_random(0)[0] for _ in range(2)]
    _, single = played(once, once.domain("source"), rng[0], np.repeat(actions, 3, 0))
    _, summed = played(thrice, thrice.domain("source"), rng[1], actions)
    np.testing.assert_allclose(summed[:, 0], single[:, 0].reshape(4, 3).sum(1), atol=1e-9)
    assert (once.horizon, thrice.horizon) == (1000, 333)


@pytest.mark.parametrize("name", ["gymnasium:Hopper-v5", "dm_control:cartpole/balance"])
def test_simulations_of_one_task_know_nothing_of_each_other(name):
    task = make_task(name)
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 2, task.domain("source").compile().nu)).astype(np.float32)

    def states(chosen):
        with closing(VectorImageEnv(task, task.domain("source"), 2, 16, 1)) as env:
            obs, _ = env.reset(seed=0)
            return np.array([obs["state"], *(env.step(a)[0]["state"] for a in chosen)])

    other = actions.copy()
    other[:, 1] *= -1
    before, after = states(actions), states(other)
    np.testing.assert_array_equal(before[:, 0], after[:, 0])
    assert np.abs(before[:, 1] - after[:, 1]).max() > 1e-3


def test_simulations_are_not_kept_for_ever():
    task = make_task("gymnasium:Swimmer-v5")
    model = task.domain("source").compile()
    data = mujoco.MjData(model)
    task.reset(model, data, np.random.default_rng(0))
    task.step(model, data, np.zeros(2))
    gone = weakref.ref(data)
    del data
    gc.collect()
    assert gone() is None


TOLD = {
    "gymnasium:HalfCheetah-v5": ({9 + i: i for i in range(8)}, ("rootx",)),
    "gymnasium:Swimmer-v5": ({5: 0, 6: 1, 7: 2}, ("slider1", "slider2")),
    "dm_control:cartpole/balance": ({3: 0}, ()),  # the angle is told by its cosine and sine
}


@pytest.mark.parametrize("name", TOLD)
def test_positions_and_velocities_are_found_in_states(name):
    task = make_task(name)
    model, rng = task.domain("source").compile(), np.random.default_rng(0)
    assert (dict(task.rates), task.unseen) == TOLD[name]
    data, states, there = mujoco.MjData(model), [], []
    task.reset(model, data, rng)
    for _ in range(8):
        task.step(model, data, rng.uniform(-1, 1, model.nu))
        mujoco.mj_forward(model, data)
        states.append(task.state(model, data))
        there.append(np.concatenate([data.qpos, data.qvel]))
    qpos, qvel = task.motion(np.array(states), task.period(model))
    told = [i for i in range(model.nq) if model.joint(model.dof_jntid[i]).name not in task.unseen]
    np.testing.assert_allclose(qpos[:, told], np.array(there)[:, told], atol=1e-9)
    np.testing.assert_allclose(qvel, np.array(there)[:, model.nq :], atol=1e-9)


@pytest.mark.parametrize("name", ["gymnasium:Ant-v5", "dm_control:walker/walk"])
def test_states_that_do_not_tell_positions_are_not_taken_to(name):
    task = make_task(name)
    with pytest.raises(ValueError, match="do not tell"):
        task.motion(np.zeros((2, 200)), 0.02)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("gymnasium:CartPole-v1", {}, r"not one of Gymnasium's MuJoCo environments.*target: \{env"),
        ("gymnasium:Nope-v0", {}, "Nope"),
        ("gymnasium:HalfCheetah-v5", {"wheels": 4}, "wheels"),
        ("gymnasium:HalfCheetah-v5", {"action_repeat": 0}, "action_repeat is 0"),
        ("dm_control:cartpole/fly", {}, "cartpole/swingup"),
        ("dm_control:cartpole", {}, "cartpole/swingup"),
        ("dm_control:cartpole/balance", {"wheels": 4}, "wheels"),
        ("dm_control:reacher/easy", {}, "changes its model where an episode begins.*geom_pos"),
        ("dm_control:lqr/lqr_2_1", {}, "no ctrlrange: motor_0"),
        ("inverted_pendulum", {"camera": "side"}, "takes none"),
        (":Arm", {}, "no import path"),
        ("nothing_here:Arm", {}, "no module 'nothing_here'"),
    ],
)
def test_what_cannot_be_a_task_is_one_sentence(name, options, message):
    with pytest.raises(ValueError, match=message):
        make_task(name, options)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ("side", "'side'; gymnasium:HalfCheetah-v5 has: track"),
        ({"azimut": 3.0}, r"task_options\.camera: .*azimut"),
        ({"distance": -1.0}, r"task_options\.camera: .*distance"),
    ],
)
def test_cameras_that_cannot_be_are_refused(camera, message):
    with pytest.raises(ValueError, match=message):
        make_task("gymnasium:HalfCheetah-v5", {"camera": camera})


def test_a_camera_is_taken_also_where_the_model_has_one_of_the_name_that_runs_use():
    """Which they used to look through whatever was asked for."""
    model = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><camera name="view" pos="9 0 1"/><camera name="side" pos="0 -3 1"/></worldbody></mujoco>'
    )

    def place(camera):
        task = SimpleNamespace(camera=camera, load=model.copy, name="two", usual_camera=lambda names: None)
        return EnvironmentTask.base(task).compile().camera("view").pos.tolist()

    assert place(None) == [9, 0, 1] and place("side") == [0, -3, 1]
    with pytest.raises(ValueError, match=r"task_options\.camera is 'sdie'.*view, side"):
        place("sdie")


def test_the_camera_stands_where_the_user_puts_it():
    """One metre in front of the cart it is twice as large as from two."""
    seen = []
    for distance in (2.0, 1.0):
        where = {"azimuth": 90.0, "elevation": 0.0, "distance": distance, "lookat": [0.0, 0.0, 0.0]}
        task = make_task("gymnasium:InvertedPendulum-v5", {"camera": where})
        with closing(VectorImageEnv(task, task.domain("source"), 1, 64, 1)) as env:
            seen.append((env.reset(seed=0)[0]["pixels"][0, 0, 32].max(-1) > 120).sum())
    assert 1.7 < seen[1] / seen[0] < 2.4


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with the user's module and URDF, from which the command is run."""
    (tmp_path / "my_arm.py").write_text(MODULE)
    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "broken.py").write_text("import json\nassert json is None, 'my own mistake'\n")
    (tmp_path / "needs.py").write_text("import a_driver_that_is_missing\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("own")
def test_a_users_own_arm_from_a_urdf():
    as_in_the_guide = make_task("my_arm:Reach")
    states = np.array([[0.1, 0.2], [0.3, 0.4]])
    assert [part.tolist() for part in as_in_the_guide.motion(states, 0.02)] == [[[0.1], [0.3]], [[0.2], [0.4]]]
    task = make_task("my_arm:Arm", {"goal": 0.5})
    assert isinstance(task, Task) and task.name == "my_arm:Arm" and task.goal == 0.5
    heavier = task.domain("source").with_effects(BodyMass("rod", 3.0))
    ends = []
    for domain in (task.domain("source"), heavier):
        with closing(VectorImageEnv(task, domain, 1, 32, 1)) as env:
            first = env.reset(seed=0)[0]["pixels"]
            for _ in range(10):
                obs, reward, *_ = env.step(np.full((1, 1), 5.0))
            assert np.abs(obs["pixels"].astype(int) - first).max() > 50, "it must be seen to move"
            assert reward[0] == pytest.approx(-abs(obs["state"][0, 0] - 0.5), abs=1e-6)
            ends.append(obs["state"][0, 0])
    assert ends[0] > 1.2 * ends[1] > 0


def typed(folder, *words):
    """Types the guide's first command that has these words, in a folder with its files. Returns what it prints."""
    for name, text in FILES.items():
        (folder / name).write_text(text)
    command = next(line for line in COMMANDS if all(word in line for word in words))
    given = [sys.executable, "-m", "cli", *shlex.split(command, comments=True)[1:]]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(given, cwd=folder, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.usefixtures("own")
def test_the_guides_lab_shows_the_same_arm_that_moves_less(tmp_path, monkeypatch):
    source, scope = make_task("my_arm:Reach"), {}
    monkeypatch.setitem(sys.modules, "my_robot", sys.modules["my_arm"])
    exec(FILES["my_lab.py"], scope)
    lab, model = scope["Lab"](), source.domain("source").compile()
    assert lab.dt == pytest.approx(source.period(model)) and lab.action_space.high.tolist() == [5.0]
    first, _ = lab.reset(seed=0)
    image, reward, *_ = lab.step([5.0])
    assert lab.observation_space.contains(image) and np.abs(image.astype(int) - first).max() > 50
    data = mujoco.MjData(model)
    data.qpos[:] = lab.reset(seed=0) and lab.data.qpos
    ours, theirs = source.step(model, data, np.array([5.0]))[0], lab.step([5.0])[1]
    assert ours > theirs == reward > -1.2


@pytest.mark.slow
def test_the_guides_files_are_a_source_and_a_target_that_suit_each_other(tmp_path):
    typed(tmp_path, "gallery")
    assert "my_robot:Reach" in (tmp_path / "gallery/index.html").read_text()
    said = typed(tmp_path, "check", "--move-target")
    assert "motor                                    -5 to 5 N·m                 -5 to 5" in said
    assert "\n- " not in said and (tmp_path / "check.png").exists()


@pytest.mark.slow
def test_the_guides_run_goes_through_every_stage(tmp_path):
    assert "IDAPT, grounding step 1" in typed(tmp_path, "fit", "--shorten")
    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "report.html").exists() and (run / "step_00/policy/final.ckpt").exists()


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("no steps", "frame_skip is 0; expected a whole number, at least 1"),
        ("a path", r"base\(\) gives str, expected a mujoco\.MjSpec"),
        ("no camera", "no camera 'view', through which it is seen; it has: front"),
        ("no range", "actuators without a ctrlrange: "),
        ("start", r"(?s)reset fails:.*Traceback.*my_arm\.py.*could not broadcast"),
        ("square", r"(?s)state\(\) after a reset is .*expected finite numbers in one row"),
        ("nan", r"(?s)state\(\) after a reset is .*nan.*expected finite numbers in one row"),
        ("alone", r"outcome\(\) gives 1\.0; expected \(reward, over\)"),
        ("array", r"outcome\(\)'s reward is array.*expected a finite number"),
        ("no number", r"outcome\(\)'s reward is nan; expected a finite number"),
        ("why", r"outcome\(\)'s second value is 'fallen'; expected True or False"),
    ],
)
def test_a_users_task_is_tried_before_anything_else_is(how, message):
    """A robot is driven before the source is, so what is wrong with it must be found where the task is made."""
    with pytest.raises(ValueError, match=message):
        make_task("my_arm:Wrong", {"how": how})
    assert make_task("my_arm:Wrong", {"how": "nothing", "action_repeat": 3}).action_repeat == 3


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("my_arm:Leg", {}, r"my_arm has no 'Leg'; it has: .*Arm"),
        ("my_arm:seven", {}, "gives int, not an idapt_pl.tasks.Task"),
        ("my_arm:fails", {"port": "/dev/ttyUSB9"}, r"(?s)Traceback.*no robot on /dev/ttyUSB9"),
        ("broken:Arm", {}, "(?s)Traceback.*my own mistake"),
        ("needs:Arm", {}, "(?s)Traceback.*a_driver_that_is_missing"),
    ],
)
def test_errors_of_a_users_module_are_shown_whole(name, options, message):
    with pytest.raises(ValueError, match=message):
        make_task(name, options)


@pytest.mark.usefixtures("own")
def test_a_function_that_says_that_it_makes_a_task_is_called():
    assert make_task("my_arm:told", {"goal": 0.5}).goal == 0.5


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("os:system", {"command": "touch called"}, "os is a module of Python itself"),
        ("subprocess:run", {"args": ["touch", "called"]}, "subprocess is a module of Python itself"),
        ("os.path:exists", {"path": "."}, r"os\.path is a module of Python itself"),
        ("builtins:exec", {}, "builtins is a module of Python itself"),
        ("gymnasium:antigravity:Arm-v0", {}, "antigravity is a module of Python itself"),
        ("numpy:save", {"file": "called", "arr": [1]}, r"no idapt_pl\.tasks\.Task"),
        ("my_arm:np.save", {"file": "called", "arr": [1]}, r"no idapt_pl\.tasks\.Task"),
        ("my_arm:silent", {}, r"not called\. If it does, write `def silent\(\.\.\.\) -> Task:`"),
        ("my_arm:another", {}, "not said to return"),
        ("my_arm:NoTask", {}, r"is the class NoTask, no idapt_pl\.tasks\.Task"),
        ("numpy:pi", {}, r"is float, no idapt_pl\.tasks\.Task"),
    ],
)
def test_what_does_not_say_that_it_makes_a_task_is_not_called(tmp_path, name, options, message):
    with pytest.raises(ValueError, match=message):
        make_task(name, options)
    assert not list(tmp_path.glob("called*"))


@pytest.mark.parametrize("command", ["report", "ledger", "evaluate"])
def test_a_config_of_somebody_elses_run_calls_nothing(tmp_path, capsys, command):
    called = tmp_path / "called"
    config = {"task": "os:system", "task_options": {"command": f"touch {called}"}}
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    assert main([command, "--run", str(tmp_path)]) == 1
    assert "os is a module of Python itself" in capsys.readouterr().err and not called.exists()


@pytest.mark.parametrize("inside", [".", "step_00/policy"])
def test_nothing_is_imported_from_a_run_folder(tmp_path, monkeypatch, inside):
    folder = tmp_path / inside
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("run.json", "config.yaml"):
        (tmp_path / name).touch()
    (folder / "not_mine.py").write_text("open('called', 'w')\n")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    said = rf"no module 'not_mine' among .*is in the run folder {tmp_path}.*in the folder of your module"
    with pytest.raises(ValueError, match=said):
        make_task("not_mine:Arm")
    assert not (folder / "called").exists()


def test_free_cameras_look_as_gymnasiums_do():
    """Reacher has no camera of its own; the image is Gymnasium's, but for shadows and the sizes of round shapes."""
    env = gymnasium.make("Reacher-v5", render_mode="rgb_array", width=64, height=64)
    env.reset(seed=0)
    theirs = env.render().astype(float)
    task = make_task("gymnasium:Reacher-v5")
    assert isinstance(task, EnvironmentTask)
    with closing(VectorImageEnv(task, task.domain("source"), 1, 64, 1)) as ours:
        ours.reset(seed=0)
        image = ours.set_state(0, env.unwrapped.data.qpos, env.unwrapped.data.qvel).astype(float)
    env.close()
    assert np.corrcoef(image.ravel(), theirs.ravel())[0, 1] > 0.9


MESH = """
<robot name="arm">
  <link name="base"/>
  <link name="rod">
    <inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm/rod.obj"/></geometry></visual></link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>"""


def test_meshes_of_a_urdf_are_looked_for_beside_it(tmp_path):
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "rod.obj").write_text("\n".join(lines))
    (tmp_path / "arm.urdf").write_text(MESH)
    model = robot_spec(tmp_path / "arm.urdf").compile()
    assert (model.ngeom, model.nmesh) == (1, 1)


def test_a_urdf_as_people_have_them_is_read_as_far_as_possible_and_says_what_is_not(tmp_path):
    (tmp_path / "rod.dae").write_text("<COLLADA/>")  # what most visual meshes of ROS are
    text = MESH.replace("rod.obj", "rod.dae").replace('ixx="0.1" iyy="0.1" izz="0.1"', 'ixx="0" iyy="0" izz="0"')
    shape = "<collision><geometry><box size='.1 .1 .6'/></geometry></collision></link>\n  <joint"
    (tmp_path / "arm.urdf").write_text(text.replace("</link>\n  <joint", shape))
    with pytest.warns(UserWarning) as warned:
        model = robot_spec(tmp_path / "arm.urdf").compile()
    said = str(warned[0].message)
    assert "its visual mesh package://arm/rod.dae is no .stl, .obj, .msh: it is not seen" in said
    assert "no inertia given for rod" in said and warned[0].filename == __file__
    assert model.ngeom == 1 and {model.body(i).name for i in range(model.nbody)} >= {"base", "rod"}
    assert (model.body("rod").inertia > 0).all() and model.body("rod").mass == pytest.approx(1)


@pytest.mark.parametrize("content", [None, "<robot", "<mujoco><bodies/></mujoco>"])
def test_a_model_that_cannot_be_read_is_named(tmp_path, content):
    path = tmp_path / "arm.xml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=r"arm\.xml: cannot be read as a model"):
        robot_spec(path)


def test_an_environment_that_a_module_here_registers_is_found_and_a_class_of_one_says_how(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p not in ("", str(tmp_path))])
    (tmp_path / "my_swings.py").write_text(
        "import gymnasium\n"
        "from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv as Swing\n"
        "gymnasium.register('MySwing-v0', entry_point=Swing, max_episode_steps=50)\n"
    )
    assert make_task("gymnasium:my_swings:MySwing-v0", {}).horizon == 50
    said = r"is an environment of Gymnasium\. Register it there .* gymnasium:my_swings:ID"
    with pytest.raises(ValueError, match=said):
        make_task("my_swings:Swing", {})

"""A robot behind a socket, moved by another process that has numpy and one copied file."""

import ast
import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import ROOT, tiny_config

from cli.main import main
from datamodules import read_trajectories
from idapt_pl.deployment import robot_server
from idapt_pl.targets.remote import RemoteRobot

CART = """
import sys

import numpy as np

from robot_server import Robot, serve_robot


class Cart(Robot):
    low, high, image, dt = [-3.0], [3.0], (40, 48, 3), 0.04
    steps = 0

    def picture(self):
        image = np.full((40, 48, 3), 60, np.uint8)
        column = int(np.clip(24 + 20 * self.x, 3, 44))
        image[25:35, column - 3 : column + 4] = (240, 200, 20)
        return image

    def reset(self, seed):
        self.x, self.v, self.t = 0.1 * np.random.default_rng(seed).normal(), 0.0, 0
        return self.picture()

    def step(self, action):
        self.steps += 1
        if self.steps == int(sys.argv[1]):
            raise OSError("the motor is hot")
        self.v += self.dt * action[0]
        self.x += self.dt * self.v
        self.t += 1
        return self.picture(), {"over": self.t == 20 or abs(self.x) > 1, "reward": 1.0}

    def stop(self):
        self.v = 0.0
        print("stopped", flush=True)


serve_robot(Cart(), port=int(sys.argv[2]))
"""


@pytest.fixture
def start(tmp_path):
    """Starts the robot's side, which fails at a step, on a port (0: any); gives the port."""
    shutil.copy(robot_server.__file__, tmp_path / "robot_server.py")
    (tmp_path / "cart.py").write_text(CART)
    running = []

    def begin(fails_at=-1, port=0):
        command = [sys.executable, "-u", "cart.py", str(fails_at), str(port)]
        running.append(subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL))
        return int(running[-1].stdout.readline().split()[-1]), running[-1]

    yield begin
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def test_the_robots_side_needs_numpy_alone():
    tree = ast.parse(Path(robot_server.__file__).read_text())
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert {name.split(".")[0] for name in imported} - set(sys.stdlib_module_names) == {"numpy"}


def test_it_is_the_robot_itself_that_is_seen_and_moved(start):
    port, _ = start()
    for _ in range(2):  # one run after the other
        robot = RemoteRobot(port=port, seconds=20)
        assert robot.dt == 0.04 and robot.action_space.high.tolist() == [3.0]
        first, _ = robot.reset(seed=1)
        again, _ = robot.reset(seed=1)
        assert robot.observation_space.contains(first) and np.array_equal(first, again)
        for _ in range(10):
            image, reward, over, cut, said = robot.step(np.array([99.0]))  # clipped there too
        where = [float(np.nonzero((i == 240).any((0, 2)))[0].mean()) for i in (first, image)]
        assert where[1] - where[0] == pytest.approx(20 * 3 * 0.04**2 * 55, abs=1)
        assert (reward, over, cut, said) == (1.0, False, False, {"success": False})
        robot.close()


def test_a_run_to_it_that_fails_in_the_middle_and_goes_on(start, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    port, process = start(fails_at=30)
    where = {"port": port, "seconds": 20}
    target = {"env": "idapt_pl.targets.remote:RemoteRobot", "options": where, "name": "cart"}
    config = tiny_config(target=target)
    config["schedule"]["grounding_steps"] = 0
    Path("my.yaml").write_text(yaml.safe_dump(config))
    command = ["fit", "--config", "my.yaml", "--run_dir", "run"]

    assert main(command) == 1
    said = capsys.readouterr().err
    assert f"target cart could not take a step: 127.0.0.1:{port} says OSError: the motor is hot. 29 of 60" in said
    process.kill()
    process.wait()
    assert main(command) == 1
    assert f"nothing answers at 127.0.0.1:{port}" in capsys.readouterr().err
    start(port=port)
    assert main(command) == 0
    recorded = list(read_trajectories("run/step_00/target.h5"))
    assert sum(map(len, recorded)) == 60 and max(map(len, recorded)) == 20
    assert json.loads(Path("run/ledger.json").read_text())["training_total"] == 60


@pytest.mark.parametrize(("reply", "says"), [
    (b"hello\n", "was lost"), (b"", "was lost"), (b'{"shape": [9, 9, 3]}\nabc', "an image broke off"),
    (b'{"shape": [99999, 99999, 3]}\n', "an image of shape"), (b'{"shape": "x"}\n', "was lost"), (b"[]\n", "was lost"),
])  # fmt: skip
def test_answers_of_something_else_are_one_sentence(reply, says):
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def once():
            connection, _ = listening.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(reply)

        thread = threading.Thread(target=once)
        thread.start()
        with pytest.raises(ConnectionError, match=says):
            RemoteRobot(port=listening.getsockname()[1], seconds=5)
        thread.join()


def test_a_server_that_is_not_there_is_one_line(tmp_path, capsys):
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    config = tmp_path / "c.yaml"
    robot = {"env": "idapt_pl.targets.remote:RemoteRobot", "options": {"port": port}}
    config.write_text(yaml.safe_dump({"task": "gymnasium:InvertedPendulum-v5", "target": robot}))
    assert main(["check", "--config", str(config), "--out", str(tmp_path / "check.png")]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"nothing answers at 127.0.0.1:{port}" in line and line.endswith("is robot_server.py running?")


def test_images_that_are_not_what_was_said_are_refused_on_the_robots_side():
    class Odd(robot_server.Robot):
        image = (4, 4, 3)

        def reset(self, seed):
            return np.zeros((4, 5, 3), np.uint8)

    (line,) = robot_server.answer(Odd(), {"do": "reset"})
    assert "an image must be uint8 (4, 4, 3), not uint8 (4, 5, 3)" in json.loads(line)["error"]
    (line,) = robot_server.answer(Odd(), {"do": "step", "action": [float("nan")]})
    assert "expected 1 finite numbers" in json.loads(line)["error"]
    for action in ([float("inf")], [0.0, 0.0]):
        (line,) = robot_server.answer(Odd(), {"do": "step", "action": action})
        assert "finite numbers" in json.loads(line)["error"]
    (line,) = robot_server.answer(robot_server.Robot(), {"do": "step", "action": [0.0]})
    assert "write step" in json.loads(line)["error"]


def stops(process):
    """Reads what the robot's side prints until it says that it stopped the robot."""
    return any(line.strip() == b"stopped" for line in iter(process.stdout.readline, b""))


@pytest.mark.parametrize("how", ["closed", "broken", "killed", "silent"])
def test_a_robot_is_stopped_when_the_run_goes_away(start, how):
    port, process = start()
    robot = RemoteRobot(port=port, seconds=20)
    robot.reset(seed=1)
    assert stops(process), "before a reset"
    robot.step(np.array([1.0]))
    if how == "closed":
        robot.close()
    elif how == "broken":  # as where the run's process crashes: what it was sent is not read
        robot._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        robot._stream.write(json.dumps({"do": "step", "action": [1.0]}).encode() + b"\n")
        robot.close()
    elif how == "killed":
        process.send_signal(signal.SIGTERM)
    assert stops(process), f"the run is {how}"
    if how == "killed":
        assert process.wait(5) == 128 + signal.SIGTERM
    else:  # the next run is served, or this one goes on
        with closing(robot if how == "silent" else RemoteRobot(port=port, seconds=20)) as following:
            if how != "silent":
                following.reset(seed=1)
            assert following.step(np.array([1.0]))[0].shape == (40, 48, 3)


def test_a_robot_is_stopped_where_an_episode_ends_or_fails(start):
    port, process = start(fails_at=22)
    with closing(RemoteRobot(port=port, seconds=20)) as robot:
        robot.reset(seed=1)
        assert stops(process)
        ends = [robot.step(np.array([0.0]))[2] for _ in range(20)]
        assert ends == [False] * 19 + [True] and stops(process)
        robot.reset(seed=1)
        assert stops(process)
        robot.step(np.array([0.0]))
        with pytest.raises(ConnectionError, match="the motor is hot"):
            robot.step(np.array([0.0]))
        assert stops(process)


def test_a_robot_is_stopped_while_its_images_are_not_taken(capsys):
    class Large(robot_server.Robot):
        image, silence, stopped = (4000, 3000, 3), 0.1, 0

        def step(self, action):
            return np.zeros(self.image, np.uint8), {}

        def stop(self):
            self.stopped += 1
            raise OSError("no power")

    robot = Large()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ours, theirs = socket.create_connection(listening.getsockname()), listening.accept()[0]
    with ours, theirs:
        serving = threading.Thread(target=robot_server.converse, args=(robot, theirs))
        serving.start()
        ours.sendall(b'{"do": "step", "action": [0.0]}\n')
        deadline = time.monotonic() + 10
        while not robot.stopped and time.monotonic() < deadline:
            time.sleep(0.01)
        assert robot.stopped
        with ours.makefile("rb") as stream:
            assert json.loads(stream.readline())["shape"] == [4000, 3000, 3]
            assert len(stream.read(36_000_000)) == 36_000_000, "a network that comes back is gone on with"
        ours.shutdown(socket.SHUT_RDWR)
        serving.join(10)
    assert not serving.is_alive()
    assert "could not be stopped" in capsys.readouterr().out


ROS_PAGE = (ROOT / "docs/guide/ros2.md").read_text()
ROS_ARM = next(part.split("```")[0] for part in ROS_PAGE.split("```python\n") if part.startswith("# my_server.py"))


class Camera:
    """Stands in for rclpy: 100 images a second, whose rows are padded and whose first number tells their place."""

    def __init__(self):
        self.sent, self.shown, self.see = [], 0, None

    def create_subscription(self, kind, topic, see, quality):
        assert quality == "best effort"
        self.see = see

    def create_publisher(self, *_):
        return types.SimpleNamespace(publish=lambda message: self.sent.append(message.data))

    def spin(self, _):
        while True:
            time.sleep(0.01)
            self.shown += 1
            rows = np.full((480, 640 * 3 + 32), min(self.shown, 255), np.uint8)
            rows[:, 640 * 3 :] = 0
            self.see(types.SimpleNamespace(data=rows.tobytes(), height=480, width=640, step=rows.shape[1]))


@pytest.fixture
def ros_arm(monkeypatch):
    """The arm of the guide, and the camera that stands in for ROS."""
    camera = Camera()
    said = {
        "rclpy": {"init": lambda **_: None, "create_node": lambda _: camera, "spin": camera.spin},
        "rclpy.qos": {"qos_profile_sensor_data": "best effort"},
        "rclpy.signals": {"SignalHandlerOptions": types.SimpleNamespace(NO=None)},
        "sensor_msgs.msg": {"Image": None},
        "std_msgs.msg": {"Float64MultiArray": types.SimpleNamespace},
        "robot_server": vars(robot_server),
    }
    for name, parts in said.items():
        module = types.ModuleType(name)
        vars(module).update(parts)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr("builtins.input", lambda _: "")
    scope = {"__name__": "my_server"}
    exec(ROS_ARM, scope)
    return scope["Arm"](), camera


def test_the_guides_ros_arm_sees_new_images_and_stops(ros_arm):
    arm, camera = ros_arm
    before = camera.shown
    (line, data) = robot_server.answer(arm, {"do": "reset"})
    assert camera.sent == [[0.0]] and json.loads(line)["shape"] == [480, 640, 3]
    assert len(set(data)) == 1 and data[0] > before, "padding is left out, and the image is not an old one"
    begin = time.monotonic()
    for _ in range(5):
        robot_server.answer(arm, {"do": "step", "action": [9.0]})
    assert time.monotonic() - begin >= 0.18 and camera.sent[1:] == [[5.0]] * 5
    camera.see = lambda _: None
    time.sleep(0.6)
    assert "no image" in robot_server.answer(arm, {"do": "step", "action": [0.0]})[0].decode()
    assert camera.sent[-1] == [0.0]

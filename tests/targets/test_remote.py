"""A robot behind a socket, moved by another process that has numpy and one copied file."""

import ast
import json
import shutil
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import tiny_config

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
    assert "not finite" in json.loads(line)["error"]
    (line,) = robot_server.answer(robot_server.Robot(), {"do": "step", "action": [0.0]})
    assert "write step" in json.loads(line)["error"]

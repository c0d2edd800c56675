"""Lets a run reach a robot whose Python is another: this file runs beside the robot, and needs numpy alone.

Copy it, write your robot, and give ``python my_server.py``. The run's config says
``target: {env: "idapt_pl.targets.remote:RemoteRobot", options: {host: "...", port: 5555}}``.

Whoever reaches the port moves the robot. It listens on its own machine alone, unless ``serve_robot`` is told otherwise;
an SSH tunnel (``ssh -L 5555:localhost:5555 robot``) needs nothing else.

``Robot.stop`` is called whenever nobody drives it: the run has gone, an episode is over or has failed, nothing has come
from the run for ``silence`` seconds or been taken by it, or this process ends (by Ctrl-C, SIGTERM or a closed terminal;
nothing can be done at SIGKILL).

Every message is a line of JSON, and an image's bytes after it:

    {"do": "describe"}                {"low": [...], "high": [...], "dt": 0.05, "image": [H, W, 3]}
    {"do": "reset", "seed": 3}        {"shape": [H, W, 3], ...} and H * W * 3 bytes
    {"do": "step", "action": [...]}   {"shape": [H, W, 3], "reward": 0.0, "over": false, "success": false} and bytes
    what goes wrong                   {"error": "..."}
"""

from __future__ import annotations

import json
import select
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np


class Robot:
    """What to fill in.

    Attributes:
        low: lower bound of every action, in the robot's units.
        high: upper bounds.
        image: shape of an image, (H, W, 3).
        dt: control period, s.
        silence: seconds without a request of the run after which the robot is stopped.
    """

    low: Any = (-1.0,)
    high: Any = (1.0,)
    image: Any = (480, 640, 3)
    dt = 0.05
    silence = 1.0

    def reset(self, seed: int | None) -> np.ndarray:
        """Put the robot where episodes begin, or have a person do it. Returns an image, uint8 (H, W, 3)."""
        raise NotImplementedError("write reset")

    def step(self, action: np.ndarray) -> tuple[np.ndarray, dict]:
        """Send an action (nu,), wait until the control period is over, and look.

        Returns:
            An image, uint8 (H, W, 3), and what there is to say: ``over`` (it fell, say), ``reward``, ``success``.
        """
        raise NotImplementedError("write step")

    def stop(self) -> None:
        """Bring the robot to rest, such as by a velocity of zero. It may rest already; a reset or step may follow."""


def serve_robot(
    robot: Robot, port: int = 5555, host: str = "127.0.0.1", ready: Callable[[int], None] | None = None
) -> None:
    """Serve a robot, one run at a time, until Ctrl-C.

    Args:
        robot: what is moved.
        port: to listen on; 0 takes any that is free.
        host: from where it can be reached; ``0.0.0.0`` is from everywhere.
        ready: is told the port.
    """
    leave_at_signals()
    try:
        with socket.create_server((host, port)) as listening:
            taken = listening.getsockname()[1]
            print(f"waiting for a run on {host}, port {taken}", flush=True)
            if ready is not None:
                ready(taken)
            while True:
                connection, address = listening.accept()
                print(f"a run from {address[0]} has come", flush=True)
                with connection:
                    converse(robot, connection)
                print("it has gone", flush=True)
    finally:
        put_to_rest(robot)


def leave_at_signals() -> None:
    """Let a process that is asked to end, or whose terminal is closed, stop the robot before it goes."""
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            if hasattr(signal, name):  # Windows has no SIGHUP
                signal.signal(getattr(signal, name), lambda number, frame: sys.exit(128 + number))


def converse(robot: Robot, connection: socket.socket) -> None:
    """Answer what one run asks for, until it goes; then stop the robot."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        with connection.makefile("rb") as stream:
            while line := next_line(robot, connection, stream):
                send_answer(robot, connection, b"".join(answer(robot, json.loads(line.decode()))))
    except (OSError, ValueError) as error:
        print(f"lost it: {error}", flush=True)
    finally:
        put_to_rest(robot)


def next_line(robot: Robot, connection: socket.socket, stream: Any) -> bytes:
    """The run's next request; the robot is stopped while there is none. Empty if the run has gone."""
    if not select.select([connection], [], [], robot.silence)[0]:  # each request waits for an answer: none is buffered
        put_to_rest(robot)
    return stream.readline()


def send_answer(robot: Robot, connection: socket.socket, answered: bytes) -> None:
    """Send an answer; the robot is stopped while nobody takes it, as where a network has gone."""
    connection.settimeout(robot.silence)
    rest = memoryview(answered)
    while rest:
        try:
            rest = rest[connection.send(rest) :]
        except socket.timeout:  # noqa: UP041  its name up to Python 3.9
            put_to_rest(robot)
    connection.settimeout(None)


def put_to_rest(robot: Robot) -> None:
    """Stop a robot; what goes wrong is shown, and ends nothing."""
    try:
        robot.stop()
    except Exception:
        print("the robot could not be stopped:", flush=True)
        traceback.print_exc()


def answer(robot: Robot, request: dict) -> list[bytes]:
    """What is sent back for a request: a line, and an image's bytes. The robot is stopped where an episode ends."""
    try:
        if request["do"] == "describe":
            told = {"low": list(map(float, robot.low)), "high": list(map(float, robot.high))}
            return [line_of({**told, "dt": float(robot.dt), "image": list(map(int, robot.image))})]
        if request["do"] == "reset":
            put_to_rest(robot)
            return shown(robot, robot.reset(request.get("seed")), {})
        action = np.asarray(request["action"], float)
        if action.shape != np.shape(robot.low) or not np.isfinite(action).all():
            raise ValueError(f"an action is {action.tolist()}; expected {np.size(robot.low)} finite numbers")
        image, told = robot.step(np.clip(action, robot.low, robot.high))
        if told.get("over"):
            put_to_rest(robot)
        return shown(robot, image, told)
    except Exception as error:  # the run says it and stops; meanwhile the robot can be put right
        put_to_rest(robot)
        traceback.print_exc()
        return [line_of({"error": f"{type(error).__name__}: {error}"})]


def shown(robot: Robot, image: np.ndarray, told: dict) -> list[bytes]:
    """A line that says what an image is, and its bytes.

    Raises:
        ValueError: if it is not what the robot is said to show.
    """
    image = np.ascontiguousarray(image)
    if image.dtype != np.uint8 or image.shape != tuple(robot.image):
        raise ValueError(f"an image must be uint8 {tuple(robot.image)}, not {image.dtype} {image.shape}")
    ends = {name: bool(told.get(name, False)) for name in ("over", "success")}
    return [line_of({"shape": list(image.shape), "reward": float(told.get("reward", 0.0)), **ends}), image.tobytes()]


def line_of(message: dict) -> bytes:
    """A message as a line of bytes."""
    return json.dumps(message).encode() + b"\n"


if __name__ == "__main__":
    serve_robot(Robot())

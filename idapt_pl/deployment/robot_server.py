"""Lets a run reach a robot whose Python is another: this file runs beside the robot, and needs numpy alone.

Copy it, write your robot, and give ``python my_server.py``. The run's config says
``target: {env: "idapt_pl.targets.remote:RemoteRobot", options: {host: "...", port: 5555}}``.

Whoever reaches the port moves the robot. It listens on its own machine alone, unless ``serve_robot`` is told otherwise;
an SSH tunnel (``ssh -L 5555:localhost:5555 robot``) needs nothing else.

Every message is a line of JSON, and an image's bytes after it:

    {"do": "describe"}                {"low": [...], "high": [...], "dt": 0.05, "image": [H, W, 3]}
    {"do": "reset", "seed": 3}        {"shape": [H, W, 3], ...} and H * W * 3 bytes
    {"do": "step", "action": [...]}   {"shape": [H, W, 3], "reward": 0.0, "over": false, "success": false} and bytes
    what goes wrong                   {"error": "..."}
"""

from __future__ import annotations

import json
import socket
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
    """

    low: Any = (-1.0,)
    high: Any = (1.0,)
    image: Any = (480, 640, 3)
    dt = 0.05

    def reset(self, seed: int | None) -> np.ndarray:
        """Put the robot where episodes begin, or have a person do it. Returns an image, uint8 (H, W, 3)."""
        raise NotImplementedError("write reset")

    def step(self, action: np.ndarray) -> tuple[np.ndarray, dict]:
        """Send an action (nu,), wait until the control period is over, and look.

        Returns:
            An image, uint8 (H, W, 3), and what there is to say: ``over`` (it fell, say), ``reward``, ``success``.
        """
        raise NotImplementedError("write step")


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


def converse(robot: Robot, connection: socket.socket) -> None:
    """Answer what one run asks for, until it goes."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection.makefile("rwb") as stream:
        try:
            for line in stream:
                for part in answer(robot, json.loads(line.decode())):
                    stream.write(part)
                stream.flush()
        except (OSError, ValueError) as error:
            print(f"lost it: {error}", flush=True)


def answer(robot: Robot, request: dict) -> list[bytes]:
    """What is sent back for a request: a line, and an image's bytes."""
    try:
        if request["do"] == "describe":
            told = {"low": list(map(float, robot.low)), "high": list(map(float, robot.high))}
            return [line_of({**told, "dt": float(robot.dt), "image": list(map(int, robot.image))})]
        if request["do"] == "reset":
            return shown(robot, robot.reset(request.get("seed")), {})
        action = np.clip(np.asarray(request["action"], float), robot.low, robot.high)
        if not np.isfinite(action).all():
            raise ValueError("an action is not finite")
        return shown(robot, *robot.step(action))
    except Exception as error:  # the run says it and stops; meanwhile the robot can be put right
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

"""A robot that another Python moves, over a socket (:mod:`~idapt_pl.deployment.robot_server` is its side)."""

from __future__ import annotations

import json
import socket
from typing import Any

import gymnasium
import numpy as np

LARGEST_IMAGE = 100_000_000
"""Bytes; more is no image."""


class RemoteRobot(gymnasium.Env):
    """A robot behind ``robot_server.py``: ``target: {env: "idapt_pl.targets.remote:RemoteRobot", options: ...}``.

    Args:
        host: where the server runs.
        port: that it listens on.
        seconds: to wait for a connection, and for every answer; more than a reset by hand takes.

    Raises:
        ConnectionError: if nothing answers there, or not as the server does.
    """

    render_mode = None

    def __init__(self, host: str = "127.0.0.1", port: int = 5555, seconds: float = 600.0) -> None:
        self._where = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=seconds)
        except OSError as error:
            raise ConnectionError(f"nothing answers at {self._where} ({error}): is robot_server.py running?") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream = self._socket.makefile("rwb")
        told, _ = self._ask({"do": "describe"})
        low, high = (np.asarray(told[end], np.float32) for end in ("low", "high"))
        self.action_space = gymnasium.spaces.Box(low, high)
        self.dt = float(told["dt"])
        self.observation_space = gymnasium.spaces.Box(0, 255, tuple(told["image"]), np.uint8)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        _, image = self._ask({"do": "reset", "seed": seed})
        return image, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        told, image = self._ask({"do": "step", "action": np.asarray(action, float).tolist()})
        return image, told["reward"], told["over"], False, {"success": told["success"]}

    def close(self) -> None:
        self._stream.close()
        self._socket.close()

    def _ask(self, request: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray]:
        """What the robot's side says, and what it shows.

        Raises:
            ConnectionError: if it says that something went wrong, or nothing that can be understood.
        """
        try:
            self._stream.write(json.dumps(request).encode() + b"\n")
            self._stream.flush()
            told = json.loads(self._stream.readline())
            image = self._read_image(told.get("shape"))
        except (OSError, ValueError, AttributeError) as error:
            raise ConnectionError(f"{self._where} was lost ({error or type(error).__name__})") from error
        if "error" in told:
            raise ConnectionError(f"{self._where} says {told['error']}")
        return told, image

    def _read_image(self, shape: Any) -> np.ndarray:
        if shape is None:
            return np.zeros(0, np.uint8)
        size = int(np.prod([int(n) for n in shape]))
        if not 0 < size <= LARGEST_IMAGE:
            raise ValueError(f"an image of shape {shape}")
        data = self._stream.read(size)
        if len(data) < size:
            raise ValueError("an image broke off")
        return np.frombuffer(data, np.uint8).reshape(shape)

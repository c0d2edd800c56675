"""A process that renders: poses go in and pixels come out, by pipes."""

from __future__ import annotations

import atexit
import functools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from idapt_pl.rendering.make import make_renderer

POSES = (
    "xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "cam_xpos", "cam_xmat", "light_xpos",
    "light_xdir",
)  # fmt: skip
"""What a picture shows of ``MjData``. Not recomputed from ``qpos`` there: after a step, ``MjData`` lags behind that."""


class RenderProcess:
    """One process, which draws models that it reads from files. It is started by the first request.

    A request is a line of JSON and the poses as they lie in memory; the answer is the frames. Nothing is pickled, and
    the program that uses this is not imported there, so it may be any script. Either side's end ends the process.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self.drawn = 0  # since it was started
        atexit.register(self.close)

    def ask(self, model: Path, size: int, data: Sequence[mujoco.MjData]) -> None:
        """Ask for one frame each of simulations of the model in a file. Ask again only after :meth:`answer`."""
        if self._process is None:
            self._start()
        self.drawn += len(data)
        request = {"model": str(model), "size": size, "frames": len(data)}
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            for d in data:
                for name in POSES:
                    self._process.stdin.write(getattr(d, name).tobytes())
            self._process.stdin.flush()
        except BrokenPipeError:
            self._has_died()

    def answer(self, out: np.ndarray) -> None:
        """Take the frames that were asked for: into uint8 (n, size, size, 3), contiguous."""
        if self._process.stdout.readinto(out) < out.nbytes:
            self._has_died()

    def close(self) -> None:
        """End it; the next request starts another."""
        if self._process is None:
            return
        process, self._process, self.drawn = self._process, None, 0
        process.stdout.close()
        try:
            process.stdin.close()
            process.wait(timeout=10)
        except (BrokenPipeError, subprocess.TimeoutExpired):
            process.kill()
            process.wait()

    def _start(self) -> None:
        path = os.pathsep.join(p or os.getcwd() for p in sys.path)
        env = os.environ | {"PYTHONPATH": path, "IDAPT_ONLY_RENDERS": "1"}
        command = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env)

    def _has_died(self) -> None:
        code = self._process.wait()
        self._process = None
        raise RuntimeError(
            f"a process that renders ended with code {code}"
            f"{' (killed, perhaps for want of memory)' if code == -signal.SIGKILL else ''}; what it said is above. "
            "A run goes on where it was when it is started again; fewer --render_processes need less memory"
        )


def serve() -> None:
    """In the process: answer until there are no more requests."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that asks
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever libraries print must not get among the frames
    for line in requests:
        request = json.loads(line)
        data, render = _loaded(request["model"], request["size"])
        poses = [getattr(data, name) for name in POSES]
        each = sum(p.nbytes for p in poses)
        asked = requests.read(each * request["frames"])  # all, before any answer: else both sides wait for each other
        for start in range(0, len(asked), each):
            _pose(poses, asked[start : start + each])
            answers.write(render(data))
        answers.flush()


def _pose(poses: Sequence[np.ndarray], values: bytes) -> None:
    values = np.frombuffer(values)
    for pose, part in zip(poses, np.split(values, np.cumsum([p.size for p in poses])[:-1]), strict=True):
        pose.flat = part


@functools.lru_cache(maxsize=4)
def _loaded(path: str, size: int) -> tuple[mujoco.MjData, object]:
    """A model's renderer, and data to show."""
    model = mujoco.MjModel.from_binary_path(path)
    return mujoco.MjData(model), make_renderer(model, size)

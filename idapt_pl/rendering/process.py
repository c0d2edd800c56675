"""A process that renders: poses go in and pixels come out, by pipes."""

from __future__ import annotations

import atexit
import functools
import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NoReturn

import mujoco
import numpy as np

from idapt_pl.rendering.make import AnyRenderer, make_renderer

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
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: IO[bytes]
        self._answers: io.BufferedReader
        self.drawn = 0  # since it was started
        atexit.register(self.close)

    def ask(self, model: Path, size: int, data: Sequence[mujoco.MjData]) -> None:
        """Ask for one frame each of simulations. Ask again only after :meth:`answer`.

        Args:
            model: file of their model (MJB).
            size: height and width of the frames, pixels.
            data: the simulations.

        Raises:
            RuntimeError: if the process has ended.
        """
        process = self._process or self._start()
        self.drawn += len(data)
        request = {"model": str(model), "size": size, "frames": len(data)}
        try:
            self._requests.write(json.dumps(request).encode() + b"\n")
            for d in data:
                for name in POSES:
                    self._requests.write(getattr(d, name).tobytes())
            self._requests.flush()
        except BrokenPipeError:
            self._has_died(process)

    def answer(self, out: np.ndarray) -> None:
        """Take the frames that were asked for: into uint8 (n, size, size, 3), contiguous.

        Raises:
            RuntimeError: if none were asked for, or the process has ended.
        """
        if self._process is None:
            raise RuntimeError("this process was asked for no frames; ask before taking the answer")
        if self._answers.readinto(out.data) < out.nbytes:
            self._has_died(self._process)

    def close(self) -> None:
        """End it; the next request starts another."""
        if self._process is None:
            return
        process, self._process, self.drawn = self._process, None, 0
        self._answers.close()
        try:
            self._requests.close()
            process.wait(timeout=10)
        except (BrokenPipeError, subprocess.TimeoutExpired):
            process.kill()
            process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        path = os.pathsep.join(p or os.getcwd() for p in sys.path)
        env = os.environ | {"PYTHONPATH": path, "IDAPT_ONLY_RENDERS": "1"}
        command = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=env, process_group=0
        )  # a group of its own: Ctrl-C is for the program that asks, also before `serve` can say so
        assert process.stdin is not None and isinstance(process.stdout, io.BufferedReader)  # as pipes are
        self._process, self._requests, self._answers = process, process.stdin, process.stdout
        return process

    def _has_died(self, process: subprocess.Popen[bytes]) -> NoReturn:
        code = process.wait()
        self._process = None
        raise RuntimeError(
            f"a process that renders ended with code {code}"
            f"{' (killed, perhaps for want of memory)' if code == -signal.SIGKILL else ''}; what it said is above. "
            "A run goes on where it was when it is started again; fewer --render_processes need less memory"
        )


def serve() -> None:
    """In the process: answer until there are no more requests."""
    for number in (signal.SIGINT, signal.SIGTERM):  # for the program that asks, whose end is the end of this one
        signal.signal(number, signal.SIG_IGN)
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever libraries print must not get among the frames
    try:
        while answer_one(requests, answers):
            pass
    except BrokenPipeError:  # who asked has ended
        os._exit(0)  # nothing is left to be flushed


def answer_one(requests: IO[bytes], answers: IO[bytes]) -> bool:
    """Answer the next request. Returns False where there is none, or only a part of one: who asked has ended."""
    line = requests.readline()
    if not line.endswith(b"\n"):
        return False
    request = json.loads(line)
    data, render = _loaded(request["model"], request["size"])
    poses = [getattr(data, name) for name in POSES]
    each = sum(p.nbytes for p in poses)
    asked = requests.read(each * request["frames"])  # all, before any answer: else both sides wait for each other
    if len(asked) < each * request["frames"]:
        return False
    for start in range(0, len(asked), each):
        _pose(poses, asked[start : start + each])
        answers.write(render(data).data)
    answers.flush()
    return True


def _pose(poses: Sequence[np.ndarray], values: bytes) -> None:
    parts = np.split(np.frombuffer(values), np.cumsum([p.size for p in poses])[:-1])
    for pose, part in zip(poses, parts, strict=True):
        pose.flat[:] = part


@functools.lru_cache(maxsize=4)
def _loaded(path: str, size: int) -> tuple[mujoco.MjData, AnyRenderer]:
    """A model's renderer, and data to show."""
    model = mujoco.MjModel.from_binary_path(path)
    return mujoco.MjData(model), make_renderer(model, size)

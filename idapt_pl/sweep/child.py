"""One attempt of ``idapt fit`` as a process of its own, which ends with the process that started it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

import idapt_pl

PROGRAM = """
import os, runpy, signal, sys, threading
signal.signal(signal.SIGTERM, signal.SIG_DFL)  # whatever its starter does at one
def leave_with_parent():
    os.read(0, 1)
    os._exit(1)
threading.Thread(target=leave_with_parent, daemon=True).start()
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""
"""Runs a module as ``python -m`` does, and leaves at once when whoever started it is gone, whatever ended that one: a
lost worker's run must not meet its successor. Nothing is ever written to standard input, so reading it returns when the
other end closes."""

FIT = ("cli", "fit")
"""Module and arguments of the command that the package's users call ``idapt fit``."""

GRACE = 90.0
"""Seconds that a run may take to leave after SIGTERM; on a machine that is not busy ``idapt fit`` takes a few."""

LAST_LINES = 6


class Attempt:
    """A process that runs until it ends or is ended; leaving the context ends it.

    Args:
        program: module and its arguments.
        log: what it says is added to this file.
        cpus: threads that its libraries compute with.
        devices: of CUDA, as in ``CUDA_VISIBLE_DEVICES``; None to leave what is set.
        cwd: folder that it runs in, if there is such a one.
    """

    def __init__(
        self, program: Sequence[str], log: Path, cpus: int, devices: str | None = None, cwd: str | None = None
    ) -> None:
        self.log, self._begun_at = log, log.stat().st_size if log.exists() else 0
        log.parent.mkdir(parents=True, exist_ok=True)
        self._file: IO[bytes] = log.open("ab")
        path = os.pathsep.join(filter(None, (str(Path(idapt_pl.__file__).parents[1]), os.environ.get("PYTHONPATH"))))
        env = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": str(cpus), "MKL_NUM_THREADS": str(cpus)}
        if devices is not None:
            env["CUDA_VISIBLE_DEVICES"] = devices
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *program],
            stdin=subprocess.PIPE,  # closes with this process, whatever ends it; then the other ends too
            stdout=self._file,
            stderr=self._file,
            env=env,
            cwd=cwd if cwd and os.path.isdir(cwd) else None,
            start_new_session=True,  # a Ctrl-C is for this process to handle
        )

    def __enter__(self) -> Attempt:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.end()
        if self.process.stdin:
            self.process.stdin.close()
        self._file.close()

    def end(self) -> None:
        """End it, so that it says what it keeps; what does not leave is killed."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(GRACE)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()

    def last_lines(self) -> list[str]:
        """The last lines that this attempt said."""
        with self.log.open("rb") as f:
            f.seek(max(self._begun_at, os.fstat(f.fileno()).st_size - 20_000))
            text = f.read().decode(errors="replace")
        return [line.rstrip()[:500] for line in text.splitlines() if line.strip()][-LAST_LINES:]

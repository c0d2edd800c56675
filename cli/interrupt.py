"""Ctrl-C and SIGTERM end a command with one line, wherever it is, and with an exit code that says it did not finish."""

from __future__ import annotations

import os
import shlex
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}
"""What a person and a scheduler send."""

ONE_PRESS = 2.0
"""Seconds within which more signals mean the same as the first: people press twice, schedulers signal whole groups."""

SWALLOWED = 10.0
"""Seconds after which the exception is raised again: a destructor that it was raised in, for example, loses it."""


class Interrupted(BaseException):
    """A signal asked this program to end. It is no KeyboardInterrupt, at which Lightning would leave without a word.

    Attributes:
        exit_code: 128 and the signal's number, as shells have it.
        kept: what is kept and how to go on.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number
        self.kept = "nothing was finished; run it again"

    def __str__(self) -> str:
        return f"stopped by {SIGNALS[signal.Signals(self.exit_code - 128)]}; {self.kept}"


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it, a signal raises :class:`Interrupted`; after that, signals are ignored while the program leaves."""
    if threading.current_thread() is not threading.main_thread():  # where Python delivers no signals
        yield
        return
    own, last = os.getpid(), -ONE_PRESS

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        if os.getpid() != own:  # a worker of a data loader, forked with this handler
            os._exit(128 + number)
        if time.monotonic() - last > ONE_PRESS:
            last = time.monotonic()
            signal.signal(signal.SIGALRM, lambda *_: raise_again(number))
            signal.setitimer(signal.ITIMER_REAL, SWALLOWED, SWALLOWED)
            raise Interrupted(number)

    def raise_again(number: int) -> None:
        raise Interrupted(number)

    before: dict[signal.Signals, Any] = {number: signal.signal(number, interrupt) for number in SIGNALS}
    before[signal.SIGALRM] = signal.getsignal(signal.SIGALRM)
    try:
        yield
    except Interrupted:
        before = dict.fromkeys(before, signal.SIG_IGN)
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def resumable(folder: Path, command: str, unit: str) -> Iterator[None]:
    """Work that goes on where it was, so that the line at its end says how.

    Args:
        folder: of the run, with its ``config.yaml``.
        command: that goes on, such as ``idapt fit``.
        unit: what is kept where it was finished, such as ``stages``.
    """
    try:
        yield
    except Interrupted as interrupted:
        config = shlex.quote(str(folder / "config.yaml"))
        interrupted.kept = f"finished {unit} are kept in {folder}, go on with: {command} --config {config}"
        raise

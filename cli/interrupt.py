"""Ctrl-C and SIGTERM end a command with one line, wherever it is, and with an exit code that says it did not finish."""

from __future__ import annotations

import logging
import os
import queue
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

HOLD_LOCKS = {threading.__file__, queue.__file__, logging.__file__}
"""Files of functions that hold locks: an exception between two of their lines leaves a lock taken for good, or a queue
(TensorBoard's, for example) that counts wrongly."""

SOON = 0.02
"""Seconds after which it is tried again, where a signal came within one of them."""


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


class Stopper:
    """Raises :class:`Interrupted` in the main thread, where that can be done."""

    def __init__(self) -> None:
        self.own, self.last = os.getpid(), -ONE_PRESS
        self.number = 0
        self.place: tuple[FrameType, int] | None = None

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """What Ctrl-C and SIGTERM call."""
        if os.getpid() != self.own:  # a worker of a data loader, forked with this handler
            os._exit(128 + number)
        if time.monotonic() - self.last > ONE_PRESS:
            self.last, self.number = time.monotonic(), number
            signal.signal(signal.SIGALRM, self.stop)
            self.stop(number, frame)

    def stop(self, _: int, frame: FrameType | None) -> None:
        """Raise it, or come back soon where a lock is being taken or left; whoever is still there then, waits there."""
        before, self.place = self.place, (frame, frame.f_lasti) if frame else None
        if frame and frame.f_code.co_filename in HOLD_LOCKS and self.place != before:
            signal.setitimer(signal.ITIMER_REAL, SOON)
            return
        signal.setitimer(signal.ITIMER_REAL, SWALLOWED, SWALLOWED)
        raise Interrupted(self.number)


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it, a signal raises :class:`Interrupted`; after that, signals are ignored while the program leaves."""
    if threading.current_thread() is not threading.main_thread():  # where Python delivers no signals
        yield
        return
    stopper = Stopper()
    before: dict[signal.Signals, Any] = {number: signal.signal(number, stopper.on_signal) for number in SIGNALS}
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


def leave_within(seconds: float, code: int) -> None:
    """End this process soon whatever is still in the way, such as a thread that waits for a lock that nobody holds."""
    timer = threading.Timer(seconds, os._exit, [code])
    timer.daemon = True
    timer.start()


@contextmanager
def resumable(folder: Path, command: str, unit: str, proof: str = "") -> Iterator[None]:
    """Work that goes on where it was, so that the line at its end says how.

    Args:
        folder: of the run, with its ``config.yaml``.
        command: that goes on, such as ``idapt fit``.
        unit: what is kept where it was finished, such as ``stages``.
        proof: a file of the folder that is there once one was; empty where that need not be asked.
    """
    try:
        yield
    except (Interrupted, SystemExit) as end:  # the second is Lightning's answer to SIGTERM, where that comes first
        signal.setitimer(signal.ITIMER_REAL, 0)
        interrupted = end if isinstance(end, Interrupted) else Interrupted(signal.SIGTERM)
        config = shlex.quote(str(folder / "config.yaml"))
        nothing = proof and not (folder / proof).exists()
        kept = f"of {unit} none was finished yet in" if nothing else f"finished {unit} are kept in"
        interrupted.kept = f"{kept} {folder}, go on with: {command} --config {config}"
        raise interrupted from None

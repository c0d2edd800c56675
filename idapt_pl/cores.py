"""What a stage computes with: the cores that nobody else uses, looked at now and then.

Threads that share one operation wait for each other actively. Where another process keeps one of their cores busy,
two of them are several times slower than one alone (``benchmarks/cores.py``).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeVar

import lightning as L
import psutil
import torch

Value = TypeVar("Value")
EVERY = 2.0
"""Seconds between looks."""
FIRST_LOOK = 0.1
"""Seconds of the look before something begins."""


class CoreUse:
    """How many cores others have used since the last look: all that is neither this process nor one of its helpers.

    Helpers are children in this process's own session, such as those that render: they work while it waits.
    """

    def __init__(self) -> None:
        self._process = psutil.Process()
        self._mine = getattr(self._process, "cpu_affinity", lambda: range(psutil.cpu_count() or 1))()
        self._last = self._times()

    def others(self) -> float:
        """Cores that others have used since this was last asked."""
        then, now = self._last, self._times()
        self._last, seconds = now, max(now[0] - then[0], 1e-3)
        return max(0.0, (now[1] - then[1]) - (now[2] - then[2])) / seconds

    def _times(self) -> tuple[float, float, float]:
        """Now; seconds that our cores were busy; seconds of them that were ours."""
        cores = psutil.cpu_times(percpu=True)
        busy = sum(sum(c[:3]) for i, c in enumerate(cores) if i in self._mine)  # user, nice or system, ...
        return time.perf_counter(), busy, self._own()

    def _own(self) -> float:
        family, session = [self._process], getattr(os, "getsid", lambda pid: 0)
        seconds = 0.0
        with suppress(psutil.Error, OSError):
            family += [p for p in self._process.children() if session(p.pid) == session(0)]
        for p in family:
            with suppress(psutil.Error):  # it has just ended
                seconds += sum(p.cpu_times()[:2])
        return seconds


def usable_threads() -> int:
    """Threads that torch would take by itself: one a core, or as many as ``OMP_NUM_THREADS`` says."""
    return _FIRST_THREADS


_FIRST_THREADS = torch.get_num_threads()


def free_threads(others: float) -> int:
    """How many threads to compute with while others use so many cores."""
    return max(1, int(usable_threads() - others + 0.5))


class FreeCores(L.Callback):
    """Has torch compute with as many threads as there are free cores, again every few seconds.

    A module with two parts that can be computed at once (``two_ways``) is told whether to, and its parts share the
    threads.

    Args:
        threads: a fixed number, for results that are the same to the bit on a busy machine; None for what is free.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.threads, self._use, self._looked = threads, CoreUse(), 0.0

    def look(self) -> None:
        """Set the threads for what comes now, by a short look at who else computes."""
        torch.set_flush_denormal(True)  # as on import (idapt_pl/__init__.py); other libraries put it back
        if self.threads is None:
            self._use.others()
            time.sleep(FIRST_LOOK)
        torch.set_num_threads(self._usable())

    def on_train_start(self, trainer: Any, pl_module: L.LightningModule) -> None:
        self.look()
        self.share(pl_module, torch.get_num_threads())

    def on_train_batch_end(self, trainer: Any, pl_module: L.LightningModule, *args: object) -> None:
        if self.threads is None and time.monotonic() - self._looked > EVERY:
            self.share(pl_module, self._usable())

    def on_train_end(self, trainer: Any, pl_module: L.LightningModule) -> None:
        torch.set_num_threads(self._usable())

    def share(self, module: L.LightningModule, threads: int) -> None:
        """Give a module so many threads."""
        two = threads > 1 and getattr(module, "two_ways", None) is not None
        if hasattr(module, "two_ways"):
            module.two_ways = two
        torch.set_num_threads(threads // 2 if two else threads)

    def _usable(self) -> int:
        self._looked = time.monotonic()
        return free_threads(self._use.others()) if self.threads is None else self.threads


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "second way")


def at_once(first: Callable[[], Value], second: Callable[[], Value]) -> tuple[Value, Value]:
    """Compute two things in two threads, each with the threads of torch that this one has; precision as here."""
    threads, mixed = torch.get_num_threads(), torch.is_autocast_enabled("cpu")
    precision = torch.get_autocast_dtype("cpu")

    def elsewhere() -> Value:
        if torch.get_num_threads() != threads:
            torch.set_num_threads(threads)
        with torch.autocast("cpu", precision, mixed, cache_enabled=False):
            return second()

    other = _pool().submit(elsewhere)
    try:
        one = first()
    finally:
        other.exception()  # whatever happens here, the other has ended
    return one, other.result()

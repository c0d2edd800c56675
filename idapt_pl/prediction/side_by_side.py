"""Calls that do not depend on each other, side by side in threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Argument = TypeVar("Argument")
Answer = TypeVar("Answer")


class SideBySide:
    """Calls in threads. MuJoCo steps without Python's lock, so simulations run on all cores.

    A window of a small machine is over so soon that threads which share one batch of windows mostly wait for each
    other. So each thread takes a whole batch, and calls from within such a call run one after the other.

    Args:
        threads: at most.
    """

    def __init__(self, threads: int) -> None:
        self.threads, self._here = threads, threading.local()

    @property
    def within(self) -> bool:
        """Whether this is one of the threads, others being busy beside it."""
        return getattr(self._here, "within", False)

    def map(self, call: Callable[[Argument], Answer], items: Iterable[Argument]) -> list[Answer]:
        """What a call makes of each item, in their order. The first error is raised, and what has not begun is left."""
        every = list(items)
        if self.within or min(self.threads, len(every)) < 2:
            return [call(x) for x in every]
        with ThreadPoolExecutor(self.threads, initializer=self._enter) as pool:
            return list(pool.map(call, every))

    def _enter(self) -> None:
        self._here.within = True

"""Work that the rest of a grounding step does not wait for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TypeVar

Outcome = TypeVar("Outcome")


class Aside(Protocol):
    """Starts a piece of work that its result is asked for later."""

    def __call__(self, name: str, last: Path, work: Callable[[], Outcome]) -> Callable[[], Outcome]:
        """Start it. What is returned waits for it and gives its result.

        Args:
            name: one of a kind in a run.
            last: the file that the work writes last: once it is there, the work is done and only to be loaded.
            work: all that it leaves is in files; it is done again in no time where they are there.
        """


def in_turn(name: str, last: Path, work: Callable[[], Outcome]) -> Callable[[], Outcome]:
    """Do it now, here."""
    result = work()
    return lambda: result

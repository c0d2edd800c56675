"""Results that are asked for again: the most recent ones are kept, up to so many bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

import numpy as np

Kept = TypeVar("Kept", np.ndarray, tuple[np.ndarray, np.ndarray])


class RecentArrays(Generic[Kept]):
    """Arrays by key, for any thread. They are shared, so they cannot be written to.

    Args:
        most_bytes: that are kept; the last result is, however large.
    """

    def __init__(self, most_bytes: int) -> None:
        self.most_bytes, self.bytes, self.found = most_bytes, 0, 0
        self._kept: OrderedDict[Hashable, Kept] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Kept]) -> Kept:
        """What was made under this key, or is made now (by each thread that asks before it is there)."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                self.found += 1
                return self._kept[key]
        made = make()
        for array in arrays_of(made):
            array.flags.writeable = False
        with self._lock:
            if key not in self._kept:
                self._kept[key] = made
                self.bytes += bytes_of(made)
            while self.bytes > self.most_bytes and len(self._kept) > 1:
                self.bytes -= bytes_of(self._kept.popitem(last=False)[1])
        return made


def arrays_of(kept: np.ndarray | tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """One array or several as several."""
    return kept if isinstance(kept, tuple) else (kept,)


def bytes_of(kept: np.ndarray | tuple[np.ndarray, ...]) -> int:
    """Bytes."""
    return sum(a.nbytes for a in arrays_of(kept))

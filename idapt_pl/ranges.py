"""Ranges of settings, so that what cannot be right is said before hours of work and not after them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Range:
    """Finite numbers from ``low`` to ``high``, in the notation of mathematics: ``(0, 1]`` leaves 0 out.

    Attributes:
        low, high: its ends.
        brackets: ``[`` or ``(`` and ``]`` or ``)``: whether the ends belong to it.
    """

    low: float
    high: float = math.inf
    brackets: str = "[]"

    def holds(self, value: float) -> bool:
        """Whether a number is in it; NaN and infinity never are."""
        inside = self.low <= value <= self.high and math.isfinite(value)
        at_an_open_end = (value == self.low and self.brackets[0] == "(") or (
            value == self.high and self.brackets[1] == ")"
        )
        return inside and not at_an_open_end

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"{'above' if self.brackets[0] == '(' else 'at least'} {self.low:g}"
        return f"in {self.brackets[0]}{self.low:g}, {self.high:g}{self.brackets[1]}"


COUNT = Range(1, 1e9)
"""Of things of which there must be one."""
COUNT_OR_NONE = Range(0, 1e9)
POSITIVE = Range(0, brackets="(]")
NOT_NEGATIVE = Range(0)
SHARE = Range(0, 1)
SEED = Range(0, 2**31 - 1)
IMAGE_SIZE = Range(8, 4096)
"""Side of rendered images, pixels."""


def check_ranges(where: str, values: Mapping[str, Any], ranges: Mapping[str, Range]) -> None:
    """Check settings; None is left to the setting's type, and of a list every number is checked.

    Args:
        where: the config's key for them, such as ``feeding``; empty for keys at the top.
        values: by name.
        ranges: by name.

    Raises:
        ValueError: naming the key, its range and what came.
    """
    for name, allowed in ranges.items():
        value = values[name]
        numbers = value if isinstance(value, list | tuple) else [value]
        if not all(number is None or allowed.holds(number) for number in numbers):
            key = f"{where}.{name}" if where else name
            raise ValueError(f"{key} must be {allowed}, got {value}")

"""Values of a map's YAML file, checked; every error names the key, what was expected and what came."""

from __future__ import annotations

import math
from typing import Any

from datamodules.recordings.errors import RecordingError, choices


def section(key: str, value: Any, known: tuple[str, ...]) -> dict:
    """A mapping with no other keys than those known."""
    if not isinstance(value, dict):
        raise RecordingError(f"{key}: expected keys among {', '.join(known)}; got {_shown(value)}")
    for name in value:
        if name not in known:
            raise RecordingError(f"{key}: unknown key {name!r}; " + choices(str(name), known, "keys are"))
    return value


def named_entries(key: str, value: Any) -> list[tuple[str, Any]]:
    """Names and what each has; none where the key is not there."""
    if value is None:
        return []
    if not isinstance(value, dict):
        raise RecordingError(f"{key}: expected one entry a name, got {_shown(value)}")
    return [(text_of(key, name), entry) for name, entry in value.items()]


def part_name(name: str) -> str:
    """The name of an array in a trajectory file, in which a slash would make a group."""
    if not name or "/" in name or "\0" in name or name == ".":
        raise RecordingError(f"infos: a name goes into the file as it is, without slashes; got {name!r}")
    return name


def column_name(key: str, value: Any) -> str:
    """A column's name."""
    if value is None:
        raise RecordingError(f"{key}: expected the name of a column, got nothing")
    return text_of(key, value)


def column_names(key: str, value: Any) -> tuple[str, ...]:
    """One column, or a list of several."""
    if not isinstance(value, list):
        return (column_name(key, value),)
    if not value:
        raise RecordingError(f"{key}: expected the name of a column or a list of names, got []")
    return tuple(column_name(key, name) for name in value)


def text_of(key: str, value: Any) -> str:
    """A name, which YAML may take for a number."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        hint = "; YAML reads yes, no, on and off as truth values, put the name in quotes" * isinstance(value, bool)
        raise RecordingError(f"{key}: expected a name, got {_shown(value)}{hint}")
    return str(value)


def number_of(key: str, value: Any) -> float:
    """A finite number."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # YAML reads 1e-3 as text
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise RecordingError(f"{key}: expected a number, got {_shown(value)}")
    return number


def count_of(key: str, value: Any) -> int:
    """A whole number, 0 or more."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise RecordingError(f"{key}: expected a whole number, 0 or more, got {_shown(value)}")
    return value


def one_of(key: str, value: Any, known: tuple) -> Any:
    """One of the values known; truth values are no numbers."""
    if not any(value == k and isinstance(value, bool) == isinstance(k, bool) for k in known):
        raise RecordingError(f"{key}: expected {' or '.join(map(str, known))}, got {_shown(value)}")
    return value


def _shown(value: Any) -> str:
    return "nothing" if value is None else repr(value)[:80]

"""The error of a recording or mapping that cannot be understood, and the pieces of its sentences."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType

LISTED = 30
"""So many names are listed in a message; the rest is counted."""


class RecordingError(ValueError):
    """A recording or its mapping is not what it should be; the message says where, what was expected, what came."""


def listing(names: Iterable[str]) -> str:
    """Names for the end of a sentence, cut where there are too many to read."""
    names = [str(n) for n in names]
    more = f", ... ({len(names) - LISTED} more)" if len(names) > LISTED else ""
    return (", ".join(names[:LISTED]) + more) or "none"


def choices(wanted: str, names: Iterable[str], what: str) -> str:
    """``did you mean 'x'? <what>: ...``, for a name that is not among the known ones.

    Args:
        wanted: the name.
        names: the known ones.
        what: how their list begins, such as ``"columns are"``.
    """
    names = [str(n) for n in names]
    near = get_close_matches(wanted, names, 1)
    return (f"did you mean {near[0]!r}? " if near else "") + f"{what}: {listing(names)}"


def optional(module: str, package: str, path: object) -> ModuleType:
    """Import a module that only some formats need.

    Args:
        module: to import.
        package: that has it, as people know it.
        path: the recording that needs it, for the message.

    Raises:
        RecordingError: if it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise RecordingError(
            f'{path}: reading it needs {package}, which is not installed; pip install "idapt[import]"'
        ) from None


def expect_magic(path: Path, magic: bytes, kind: str) -> None:
    """Raise a RecordingError if a file does not begin as those of its kind do."""
    with path.open("rb") as f:
        start = f.read(len(magic))
    if start != magic:
        came = f"it begins with {start!r}" if start else "it is empty"
        raise RecordingError(f"{path}: not a {kind}: {came}")

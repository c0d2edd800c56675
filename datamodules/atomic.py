"""Files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk, quota or file that can take no more."""

TEMPORARY = re.compile(r"\.(?P<name>.+)\.(?P<pid>\d+)\.tmp")
"""What :func:`write_atomically` calls a file that it has not finished, by the file's name and its own process."""


def write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then rename it; on any error nothing is left.

    Raises:
        OSError: if it could not be written; the message names the file.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(temporary)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        hint = " Free some space and run it again." if error.errno in FULL else ""
        raise OSError(
            f"could not write {path}: {error.strerror or error}. Nothing was left half-written.{hint}"
        ) from None


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write bytes atomically, and to the disk itself: after a power failure the file is whole or as it was.

    Raises:
        OSError: as of :func:`write_atomically`.
    """

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as f:
            f.write(data)
            f.flush()
            os.fsync(f.fileno())

    write_atomically(path, write)


def remove_stale(path: Path) -> list[Path]:
    """Remove what killed processes left of files that they did not finish. Returns what was removed.

    Args:
        path: a file that is about to be written, for its own remains; or a folder that nothing of this process has
            been written to yet, for all remains in it and below.
    """
    folder, name = (path, None) if path.is_dir() else (path.parent, path.name)
    removed = []
    for found in [*folder.rglob(".*.tmp")] if name is None else [*folder.glob(".*.tmp")]:
        told = TEMPORARY.fullmatch(found.name)
        if told and name in (None, told["name"]) and not at_work(int(told["pid"])):
            found.unlink(missing_ok=True)
            removed.append(found)
    return removed


def at_work(pid: int) -> bool:
    """Whether another process has this number; a number of our own is of one that is gone, as in a new container."""
    if pid == os.getpid():
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True

"""Files of a run: written so that a crash never leaves half of one, read so that damage is found and named."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from datamodules.atomic import write_atomically, write_bytes
from datamodules.safe_yaml import read_yaml

__all__ = ["read_yaml", "write_atomically", "write_bytes"]

REDO = "Delete it, and the same `idapt fit` command makes it again."
"""What to do about a damaged file of a run, unless something else helps."""


class DamagedFile(ValueError):
    """A file cannot be used; the message names it, and says why and what to do."""


@contextmanager
def blaming(path: Path, cure: str = REDO) -> Iterator[None]:
    """Whatever fails within is the fault of a file: said in one line that names it and what to do.

    Args:
        path: the file that is read.
        cure: what to do about it, a sentence.

    Raises:
        DamagedFile: for any error.
    """
    try:
        yield
    except DamagedFile:  # of this file, or of one that tells about it
        raise
    except Exception as error:  # what damaged data do to their readers can be anything
        said = getattr(error, "strerror", None) or str(error) or type(error).__name__
        reason = " ".join(said.split())[:300].removeprefix(f"{path}: ")
        kind = "it does not hold " if isinstance(error, KeyError) else ""
        raise DamagedFile(f"{path}: cannot be used ({kind}{reason}). {cure}") from error


def content_checksum(value: dict) -> str:
    """SHA-256 of what a JSON object holds, however it is laid out."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def write_json(path: Path, value: dict, checked: bool = False) -> None:
    """Write a JSON object atomically.

    Args:
        path: of the file.
        value: what it shall hold.
        checked: add its :func:`content_checksum` under ``checksum``, so that :func:`read_json` finds damage.
    """
    value = json.loads(json.dumps(value))  # as it will be read
    if checked:
        value = value | {"checksum": content_checksum(value)}
    write_bytes(path, f"{json.dumps(value, indent=2)}\n".encode())


def read_json(path: Path, keys: Collection[str] = (), cure: str = REDO) -> dict:
    """Read a JSON object, without its checksum.

    Args:
        path: of the file.
        keys: what it must hold.
        cure: as of :func:`blaming`.

    Raises:
        DamagedFile: if it is missing, damaged, or something else.
    """
    with blaming(path, cure):
        value = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(value, dict):
            raise ValueError("it is no JSON object")
        noted = value.pop("checksum", None)
        if noted is not None and noted != content_checksum(value):
            raise ValueError("its content does not agree with its checksum")
        if missing := [k for k in keys if k not in value]:
            raise ValueError(f"{missing[0]!r} is missing in it")
        return value


def write_yaml(path: Path, value: Any) -> None:
    """Write YAML atomically."""
    write_bytes(path, yaml.safe_dump(value, sort_keys=False, allow_unicode=True).encode())


# --- a file and the note beside it ----------------------------------------------------------------------


def sha256(path: Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def note_of(path: Path) -> Path:
    """The JSON file that tells how a checkpoint or recording of a run came to be, and its SHA-256."""
    return path.with_name("stage.json") if path.name == "final.ckpt" else path.with_suffix(".json")


def verify(path: Path) -> None:
    """Compare a checkpoint or recording with the SHA-256 that was noted when it was written; older ones have none.

    Raises:
        DamagedFile: if they disagree, or the note is damaged.
    """
    note = note_of(path)
    if not note.exists():
        return
    lost = f"the folder {note.parent}, and the same `idapt fit` command redoes the stage"
    if path.name != "final.ckpt":
        lost = f"it: all it holds are the checksum and the duration of {path.name}"
    noted = read_json(note, cure=f"Delete {lost}.").get("sha256")
    with blaming(path):
        if noted is not None and noted != sha256(path):
            raise ValueError(f"its content does not agree with the checksum in {note.name}")

"""Warnings of a run, kept in its folder: in the log they scroll away, and they often say what to do."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock

from idapt_pl.files import read_json, write_json

WARNINGS = "warnings.json"
OURS = ("idapt_pl", "cli", "datamodules")
"""Packages whose warnings are kept."""
LONGEST_WAIT = 30.0
"""For another process that writes, s."""


class WarningKeeper(logging.Handler):
    """Writes every warning of this project to a run folder; of those that differ in numbers alone the newest.

    Several processes may do so.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(logging.WARNING)
        self.folder = folder

    def emit(self, record: logging.LogRecord) -> None:
        """Add a warning to those that are there. Where it cannot be written, as on a full disk, the log has it."""
        if record.name.split(".")[0] not in OURS:
            return
        said, path = record.getMessage(), self.folder / WARNINGS
        with suppress(OSError, ValueError), FileLock(path.with_name(f".{path.name}.lock"), timeout=LONGEST_WAIT):
            others = [w for w in read_warnings(self.folder) if without_numbers(w) != without_numbers(said)]
            write_json(path, {"warnings": [*others, said]})


def without_numbers(said: str) -> str:
    """A sentence with all numbers alike."""
    return re.sub(r"-?\d+(\.\d+)?", "#", said)


@contextmanager
def keeping_warnings(folder: Path) -> Iterator[None]:
    """Keep what is warned of meanwhile."""
    keeper = WarningKeeper(folder)
    logging.getLogger().addHandler(keeper)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(keeper)


def read_warnings(folder: Path) -> list[str]:
    """Sentences that a run warned with, the oldest first.

    Raises:
        ValueError: the file is damaged.
    """
    path = folder / WARNINGS
    return [str(w) for w in read_json(path, ("warnings",))["warnings"]] if path.exists() else []

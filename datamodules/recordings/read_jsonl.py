"""JSON lines: one object a line, which is a row."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.recordings.errors import RecordingError
from datamodules.recordings.frames import named_files
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.messages import as_columns, flatten
from datamodules.recordings.recorded import Recorded

LONGEST_LINE = 1_000_000
"""Characters of a line; a longer one is no row of numbers."""
MOST_COLUMNS = 4096
"""Columns that all lines together may have."""


def read_jsonl(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a file as one episode: columns ``arm.q[0]``, ``arm.q[1]`` of ``{"arm": {"q": [0, 1]}}``.

    Rows are named by their line. What a line does not have is empty there. A column of images has the names of their
    files, from the file's folder on.

    Raises:
        RecordingError: naming the file and line, what was expected and what came.
    """
    rows: list[dict[str, Any]] = []
    numbers: list[int] = []
    names: set[str] = set()
    try:
        with path.open(encoding="utf-8-sig") as f:
            number = 0
            while text := f.readline(LONGEST_LINE + 1):
                number += 1
                if text.strip():
                    rows.append(_row(path, number, text))
                    numbers.append(number)
                    names |= rows[-1].keys()
                if len(names) > MOST_COLUMNS:
                    raise RecordingError(
                        f"{path}: line {number}: more than {MOST_COLUMNS} columns up to here; expected the same keys "
                        "in every line"
                    )
    except UnicodeDecodeError:
        raise RecordingError(f"{path}: not a text file; expected JSON lines in UTF-8") from None
    if not names:
        raise RecordingError(f"{path}: is empty; expected one JSON object a line, with numbers")
    columns = as_columns(rows)
    if mapping.images is not None and mapping.images.column in columns:
        named = columns[mapping.images.column]
        columns[mapping.images.column] = named_files(named, path.parent, mapping.images.size)
    return [Recorded(str(path), columns, "line", np.array(numbers))]


def _row(path: Path, number: int, text: str) -> dict[str, Any]:
    """Flat fields of a line."""
    if len(text) > LONGEST_LINE:
        raise RecordingError(f"{path}: line {number} is longer than {LONGEST_LINE} characters; expected one row a line")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        told = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise RecordingError(
            f"{path}: line {number}: not JSON: {told}; delete the line if the recorder was cut off there"
        ) from None
    if not isinstance(content, dict):
        raise RecordingError(f'{path}: line {number}: expected a JSON object such as {{"t": 0}}, got {text[:40]!r}')
    return flatten(content)

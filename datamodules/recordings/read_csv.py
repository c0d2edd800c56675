"""Text tables: comma, semicolon or tab separated, with or without a header."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import numpy as np

from datamodules.recordings.errors import RecordingError
from datamodules.recordings.frames import named_files
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded, is_number

EXACT = 2**53
"""Whole numbers from here on are not all in float64."""


def read_csv(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a table as one episode. Rows are named by their line in the file, columns by the header.

    A column of images has the names of their files, from the table's folder on.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    lines = _lines(path, mapping)
    first_line = lines[0][0]
    names = [name.strip() for name in lines[0][1]]
    if mapping.header and not (mapping.survey and all(map(is_number, names))):
        names[0] = names[0].removeprefix("#").strip()
        lines = lines[1:]
        _check_header(path, mapping, names)
    else:
        names = [str(i) for i in range(len(names))]
    if not lines:
        raise RecordingError(f"{path}: has a header but no rows")
    for number, cells in lines:
        if len(cells) != len(names):
            raise RecordingError(
                f"{path}: line {number} has {len(cells)} cells, expected {len(names)} as line {first_line} has"
            )
    columns = {name: _column([cells[i] for _, cells in lines]) for i, name in enumerate(names)}
    if mapping.images is not None and mapping.images.column in columns:
        named = columns[mapping.images.column]
        columns[mapping.images.column] = named_files(named, path.parent, mapping.images.size)
    return [Recorded(str(path), columns, "line", np.array([number for number, _ in lines]))]


def _lines(path: Path, mapping: Mapping) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that is not empty, after the skipped ones."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as f:
            for _ in range(mapping.skip_rows):
                if not f.readline():
                    break
            start = f.tell()
            delimiter = mapping.delimiter or _delimiter(f.readline())
            f.seek(start)
            reader = csv.reader(f, delimiter=delimiter, skipinitialspace=True)
            lines = [(mapping.skip_rows + reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: not a text table: {error}") from None
    if not lines:
        after = f" after the {mapping.skip_rows} skipped rows" if mapping.skip_rows else ""
        raise RecordingError(f"{path}: is empty{after}; expected a header and rows")
    return lines


def _delimiter(line: str) -> str:
    """The separator that the first line has most of."""
    return max(",;\t", key=line.count)


def _check_header(path: Path, mapping: Mapping, names: list[str]) -> None:
    if all(map(is_number, names)):
        raise RecordingError(
            f"{path}: expected column names, got numbers ({', '.join(names[:4])} ...); "
            "if it has no header write header: false in the map and name columns 0, 1, ..."
        )
    twice = [name for name, n in Counter(names).items() if n > 1 and name in set(mapping.columns())]
    if twice:
        raise RecordingError(f"{path}: column {twice[0]!r} stands twice in the header; rename one")


def _column(cells: list[str]) -> np.ndarray:
    """Numbers if they all are, an empty cell being NaN; else text. Stamps in ns, too large for float64, stay whole."""
    try:
        numbers = np.array([cell.strip() or "nan" for cell in cells], dtype=np.float64)
    except ValueError:
        return np.array([cell.strip() for cell in cells], dtype=object)
    if np.nanmax(np.abs(numbers), initial=0) < EXACT:
        return numbers
    try:
        return np.array(cells, dtype=np.int64)
    except (ValueError, OverflowError):
        return numbers

"""One recorded episode as named columns: what every reader returns, before anything is interpreted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from datamodules.recordings.errors import RecordingError, choices

WIDEST = 512
"""An array with more columns than this is an image or a scan, not joints, and is left out."""


@dataclass(frozen=True)
class Recorded:
    """Columns of one episode.

    Attributes:
        source: file (and episode) for messages.
        columns: name to array of shape (rows,), numbers or text, in the recording's units; images, if the map asks for
            them, are uint8 (rows, S, S, 3). Formats that keep actions apart from observations have columns that are
            one row shorter.
        row_word, row_numbers: how a person finds row k: ``f"{row_word} {row_numbers[k]}"``; None counts from 0.
        notes: what its reader has to tell of it.
    """

    source: str
    columns: dict[str, np.ndarray] = field(repr=False)
    row_word: str = "row"
    row_numbers: np.ndarray | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    def row(self, k: int) -> str:
        """Where row k is, in the recording's own count."""
        return f"{self.row_word} {k if self.row_numbers is None else self.row_numbers[k]}"

    def column(self, name: str, needed_by: str) -> np.ndarray:
        """A column by name, (rows,).

        Args:
            name: of the column.
            needed_by: the key of the map that names it, for the message.

        Raises:
            RecordingError: if there is none; the message lists those there are.
        """
        if name not in self.columns:
            raise RecordingError(
                f"{self.source}: no column {name!r}, which the map names at {needed_by}; "
                + choices(name, self.columns, "columns are")
            )
        return self.columns[name]

    def numbers(self, name: str, needed_by: str, keep: slice = slice(None)) -> np.ndarray:
        """A column's finite numbers (rows,); integers stay integers, so that ns stay exact.

        Args:
            name: of the column.
            needed_by: the key of the map that names it, for the message.
            keep: the rows that are wanted; others may hold anything.

        Raises:
            RecordingError: naming the first row that holds no finite number, and what it holds.
        """
        values = self.column(name, needed_by)[keep]
        first = range(*keep.indices(len(self.columns[name])))
        if values.dtype.kind not in "fiub":
            if (k := next((k for k, v in enumerate(values) if not is_number(v)), None)) is not None:
                text = str(values[k])
                hint = "; write decimals with a point" if is_number(text.replace(",", ".")) else ""
                raise RecordingError(
                    f"{self.source}: column {name!r}, {self.row(first[k])}: expected a number, got {text!r}{hint}"
                )
            values = values.astype(np.float64)
        if len(bad := np.flatnonzero(~np.isfinite(values))):
            hold = "" if needed_by == "time.column" else "let the last value hold (hold: true of the channel), "
            raise RecordingError(
                f"{self.source}: column {name!r}, {self.row(first[bad[0]])}: expected a number, got "
                f"{values[bad[0]]} or nothing ({len(bad)} such rows); cut the recording there, fill the gap, "
                f"{hold}or let --repair leave such rows out"
            )
        return values.astype(np.int64 if values.dtype.kind in "iu" else np.float64)

    def rows(self, start: int, end: int, of: int) -> Recorded:
        """Rows from ``start`` to before ``end``, of ``of``; columns that are one row shorter stay so."""
        ends = {of: end, of - 1: end - 1}
        numbers = np.arange(of) if self.row_numbers is None else self.row_numbers
        columns = {k: a[start : ends[len(a)]] for k, a in self.columns.items() if len(a) in ends}
        return replace(self, columns=columns, row_numbers=numbers[start:end])

    def without(self, drop: list[int], of: int) -> Recorded:
        """The rows but some, of ``of``; in a column that is one row shorter, the row from each row left to the next."""
        left = np.delete(np.arange(of), drop)
        index = {of: left, of - 1: left[:-1]}
        numbers = np.arange(of) if self.row_numbers is None else self.row_numbers
        columns = {k: a[index[len(a)]] for k, a in self.columns.items() if len(a) in index}
        return replace(self, columns=columns, row_numbers=numbers[left])

    def split(self, name: str) -> list[Recorded]:
        """Episodes by a column that names them: rows with one value are one episode, in order of appearance."""
        ids = self.column(name, "episodes.column")
        values, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
        numbers = np.arange(len(ids)) if self.row_numbers is None else self.row_numbers
        whole = {k: a for k, a in self.columns.items() if len(a) == len(ids)}
        return [
            replace(
                self,
                source=f"{self.source}: {name} {values[i]:g}"
                if ids.dtype.kind == "f"
                else f"{self.source}: {name} {values[i]}",
                columns={k: a[inverse == i] for k, a in whole.items()},
                row_numbers=numbers[inverse == i],
            )
            for i in np.argsort(first)
        ]


def is_number(text: Any) -> bool:
    """Whether a cell reads as a number."""
    try:
        float(text)
    except (TypeError, ValueError):
        return False
    return True


def flat_columns(name: str, array: np.ndarray, labels: list[str] | None = None) -> dict[str, np.ndarray]:
    """Columns of an array (rows,) or (rows, n): ``name``, or ``name[i]`` and, with n labels, ``name[label]``."""
    array = np.asarray(array)
    if array.ndim == 1:
        return {name: array}
    if array.ndim != 2 or array.shape[1] > WIDEST:
        return {}
    columns = {f"{name}[{i}]": array[:, i] for i in range(array.shape[1])}
    if labels is not None and len(labels) == array.shape[1]:
        columns = {f"{name}[{label}]": a for label, a in zip(labels, array.T, strict=True)} | columns
    return ({name: array[:, 0]} if array.shape[1] == 1 else {}) | columns

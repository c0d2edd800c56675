"""Tables of results: CSV files that benchmarks add to as they go, written whole and atomically."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from idapt_pl.files import write_atomically

Row = Mapping[str, object]


def read_rows(path: Path) -> list[dict]:
    """The rows of a table as text; none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as f:
        return list(csv.DictReader(f))


def write_rows(path: Path, rows: Iterable[Row], fields: Sequence[str] = ()) -> None:
    """Write a table.

    Args:
        path: of the file; its folder is made.
        rows: what is missing in a row is left empty.
        fields: the columns; default those of all rows, in order of appearance.
    """
    rows = list(rows)
    columns = fields or list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)

    def dump(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as f:
            table = csv.DictWriter(f, columns, lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    write_atomically(path, dump)


def replace_rows(path: Path, rows: Sequence[Row], key: Sequence[str], fields: Sequence[str] = ()) -> None:
    """Put rows into a table in place of those that agree with one of them in the columns ``key``."""

    def identity(row: Row) -> tuple[str, ...]:
        return tuple(str(row[k]) for k in key)

    new = {identity(row) for row in rows}
    write_rows(path, [*(row for row in read_rows(path) if identity(row) not in new), *rows], fields)

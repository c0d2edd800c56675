"""Figures and tables of pages, filled in from results/*.csv.

    python benchmarks/figures.py            # write what the tables say into README.md and docs/
    python benchmarks/figures.py --check    # say what differs; exit code 1 if anything does

A figure stands between two comments that do not show; the first, without spaces, says where it comes from:

    <!--results/own_targets.csv:mean:grounding_step=0:.0f-->64<!--/-->

These are a table, a column, the rows (``&`` between conditions, ``+`` for a space, ``%3A`` for a colon, none for all
rows) and a format. The figure is the value of the column in these rows, which must agree; ``sum(minutes)``,
``mean(...)``, ``median(...)``, ``min(...)``, ``max(...)`` and ``count(...)`` make one of several, and
``sum(after_s)/60`` divides it.
Between ``<!--tables:hard-->`` and ``<!--/tables-->`` stands what ``python benchmarks/tables.py hard`` prints.
"""

from __future__ import annotations

import argparse
import csv
import re
import statistics
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import unquote_plus

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import TABLES

FIGURE = re.compile(r"<!--(results/[\w.]+\.csv):([^:\s>]+):([^:\s]*):([^:\s]+?)-->(.*?)<!--/-->", re.DOTALL)
TABLE = re.compile(r"(<!--tables:(\w+)-->\n\n)(.*?)(\n\n<!--/tables-->)", re.DOTALL)
COLUMN = re.compile(r"(?:(sum|mean|median|min|max|count)\((\w+)\)|(\w+))(?:/([\d.]+))?")
SEVERAL: dict[str, Callable[[list[float]], float]] = {
    "sum": sum,
    "mean": lambda values: sum(values) / len(values),
    "median": statistics.median,
    "min": min,
    "max": max,
    "count": len,
}


def pages(root: Path = ROOT) -> list[Path]:
    """Pages that may have figures."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def value_of(table: str, column: str, rows: str, shape: str, root: Path = ROOT) -> str:
    """What a figure's table says.

    Args:
        table: path of a CSV file.
        column: as in this module's docstring.
        rows: conditions.
        shape: format of the number.
        root: of the repository.

    Raises:
        ValueError: if there is no such row or column, or rows disagree.
    """
    found = COLUMN.fullmatch(column)
    if found is None:
        raise ValueError(f"{column} is no column, nor sum(...) and the like")
    several, name, divisor = found[1], found[2] or found[3], float(found[4] or 1)
    wanted = dict(unquote_plus(part).split("=", 1) for part in rows.split("&") if part)
    with (root / table).open(newline="", encoding="utf-8") as f:
        every = list(csv.DictReader(f))
    if missing := [key for key in (name, *wanted) if every and key not in every[0]]:
        raise ValueError(f"{table} has no column {', '.join(missing)}")
    values = [row[name] for row in every if all(row[k] == v for k, v in wanted.items())]
    if several is None and len(set(values)) != 1:
        raise ValueError(
            f"{table}: {len(values)} rows have {rows}, with {len(set(values))} values of {name}; one is wanted"
        )
    if not values:
        raise ValueError(f"{table}: no row has {rows}")
    numbers = [float(v) for v in values if v] if several != "count" else [0.0] * len(values)
    return format(SEVERAL[several or "max"](numbers) / divisor, shape)


def differing(text: str, root: Path = ROOT) -> Iterator[tuple[str, str, str]]:
    """Figures and tables of a page that results/*.csv do not have: where from, what stands there, what should."""
    for found in FIGURE.finditer(text):
        should = value_of(found[1], found[2], found[3], found[4], root)
        if found[5] != should:
            yield ":".join(found.groups()[:4]), found[5], should
    for found in TABLE.finditer(text):
        if found[3] != (should := TABLES[found[2]](root / "results")):
            yield f"table {found[2]}", found[3], should


def filled_in(text: str, root: Path = ROOT) -> str:
    """A page with all figures and tables as results/*.csv have them."""
    text = FIGURE.sub(
        lambda m: m[0].replace(f"-->{m[5]}<!--", f"-->{value_of(m[1], m[2], m[3], m[4], root)}<!--"), text
    )
    return TABLE.sub(lambda m: m[1] + TABLES[m[2]](root / "results") + m[4], text)


def main() -> int:
    """Fill figures in, or compare them."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--check", action="store_true", help="write nothing")
    check, wrong = p.parse_args().check, 0
    for page in pages():
        text = page.read_text(encoding="utf-8")
        for where, stands, should in differing(text):
            said = "differs" if where.startswith("table") else f"is {should}, not {stands}"
            print(f"{page.relative_to(ROOT)}: {where} {said}")
            wrong += 1
        if not check and (new := filled_in(text)) != text:
            page.write_text(new, encoding="utf-8")
    return int(check and wrong > 0)


if __name__ == "__main__":
    sys.exit(main())

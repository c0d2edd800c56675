"""What is taken for what: effects that were hidden and effects that were named, over the tables of results.

    python benchmarks/confusion.py            # prints the table, and writes results/confusion.csv

Reads the columns ``truth`` and ``found`` of diagnosis*.csv and several_effects.csv, and runs nothing. Tables of the
same cases under other conditions count on their own. Numerics are left out. What is named at another place (joint,
body) than where it was hidden is ``<effect> elsewhere``; what has no partner is hidden or named beside ``nothing``.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.tables import read_rows, write_rows

FIELDS = ("truth", "found", "count")
NOTHING = "nothing"


def labels(text: str) -> list[tuple[str, str]]:
    """Effects and targets in a cell, such as ``joint_damping(knee) damping=0.1 + payload(hand)``."""
    found = re.findall(r"(\w+)\(([^()]*)\)", text)
    return [(effect, target) for effect, target in found if effect != "numerics"]


def pairs(truth: list[tuple[str, str]], found: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """What was taken for what in one row: first what is the same, then the same effect elsewhere, then in order."""
    truth, found, out = list(truth), list(found), []
    for alike in (lambda a, b: a == b, lambda a, b: a[0] == b[0], lambda a, b: True):
        for a in list(truth):
            b = next((b for b in found if alike(a, b)), None)
            if b is not None:
                truth.remove(a), found.remove(b)
                out.append((a[0], b[0] if a == b else f"{b[0]} elsewhere" if a[0] == b[0] else b[0]))
    return [*out, *((a, NOTHING) for a, _ in truth), *((NOTHING, b) for b, _ in found)]


def counted(rows: Iterable[dict]) -> Counter[tuple[str, str]]:
    """How often each pair is in rows; where nothing was hidden nor named it is once nothing for nothing."""
    total: Counter[tuple[str, str]] = Counter()
    for r in rows:
        total.update(pairs(labels(r["truth"]), labels(r["found"])) or [(NOTHING, NOTHING)])
    return total


def as_table(total: Counter[tuple[str, str]]) -> str:
    """Markdown: a row for each hidden effect, with how often it was named right, and what else it was taken for."""
    lines = ["| hidden | times | named so | taken for |", "|---|---|---|---|"]
    for kind in sorted({truth for truth, _ in total}):
        of = {found: n for (truth, found), n in total.items() if truth == kind}
        others = sorted(((n, f) for f, n in of.items() if f != kind), key=lambda x: (-x[0], x[1]))
        told = ", ".join(f"{f} {n}" for n, f in others)
        lines.append(f"| {kind} | {sum(of.values())} | {of.get(kind, 0)} | {told} |")
    return "\n".join(lines)


def main() -> None:
    """Read the tables, count, write, print."""
    results = ROOT / "results"
    read = [*sorted(results.glob("diagnosis*.csv")), results / "several_effects.csv"]
    tables = [rows for path in read if (rows := read_rows(path)) and {"truth", "found"} <= rows[0].keys()]
    total = counted(r for rows in tables for r in rows)
    rows = [{"truth": t, "found": f, "count": n} for (t, f), n in sorted(total.items())]
    write_rows(results / "confusion.csv", rows, FIELDS)
    print(as_table(total))


if __name__ == "__main__":
    main()

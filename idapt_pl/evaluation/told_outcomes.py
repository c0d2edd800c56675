"""Outcomes of episodes that a person played and judged: a table, where a target cannot be played from here."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from idapt_pl.rl.returns import EpisodeOutcome, Returns

COLUMNS = ("step", "outcome", "control_steps")
"""Whose policy played (0, 1, ...; ``direct`` for the source's), how it went, and how long it was."""

YES_OR_NO = {"y": 1.0, "yes": 1.0, "true": 1.0, "n": 0.0, "no": 0.0, "false": 0.0}


def read_told_outcomes(path: Path, success: bool) -> dict[str, Returns]:
    """Outcomes by the policy that was played, as the table names it.

    Args:
        path: a CSV file with :data:`COLUMNS`, a row for each episode.
        success: whether outcomes are whether the goal was reached (y or n), and no returns.

    Raises:
        ValueError: naming the row, what was expected and what came.
    """
    told: dict[str, list[EpisodeOutcome]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = [[cell.strip() for cell in row] for row in csv.reader(file) if any(row)] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: cannot be read ({error})") from None
    if tuple(header) != COLUMNS or not rows:
        raise ValueError(f"{path}: expected the columns {','.join(COLUMNS)} and a row for each episode")
    for number, row in enumerate(rows, 2):
        if len(row) != len(COLUMNS):
            raise ValueError(f"{path}: row {number} is {','.join(row)}; expected {','.join(COLUMNS)}")
        gained, steps = as_outcome(row[1], success), row[2]
        if gained is None:
            expected = "y or n, as the task's metric is success" if success else "a return"
            raise ValueError(f"{path}: row {number}: the outcome is {row[1]!r}; expected {expected}")
        if not steps.isdecimal() or not int(steps):
            raise ValueError(f"{path}: row {number}: control_steps is {steps!r}; expected a whole number, at least 1")
        reached = gained > 0 if success else None
        told.setdefault(row[0], []).append(EpisodeOutcome(gained, reached, int(steps)))
    return {policy: Returns.of(outcomes) for policy, outcomes in told.items()}


def as_outcome(said: str, success: bool) -> float | None:
    """An outcome as a number; None if it is none."""
    if success and said.lower() in YES_OR_NO:
        return YES_OR_NO[said.lower()]
    try:
        number = float(said)
    except ValueError:
        return None
    return number if math.isfinite(number) and (not success or number in (0, 1)) else None

"""Outcomes of episodes in a target that cannot be played again, kept until all that were asked for are there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from idapt_pl.files import blaming, read_json, write_json

SO_FAR = "_so_far.json"
"""Ends the name of such a file; what is before it is the name of the measurement."""


class KeptOutcomes:
    """A JSON file with the outcomes of a measurement that is not complete, each with its ``steps``.

    Args:
        folder: of the grounding step.
        measurement: its name.

    Raises:
        DamagedFile: if there is one that cannot be read.
    """

    def __init__(self, folder: Path, measurement: str) -> None:
        self.path = folder / f"{measurement}{SO_FAR}"
        self._outcomes = read_outcomes(self.path) if self.path.exists() else []

    def __iter__(self) -> Any:
        return iter(self._outcomes)

    @property
    def steps(self) -> int:
        """Control steps of all of them."""
        return total_steps(self._outcomes)

    def add(self, outcome: dict[str, Any]) -> None:
        """Keep one more."""
        self._outcomes.append(outcome)
        write_json(self.path, {"outcomes": self._outcomes}, checked=True)

    def forget(self) -> None:
        """They are in the result now."""
        self.path.unlink(missing_ok=True)


def read_outcomes(path: Path) -> list[dict[str, Any]]:
    """Outcomes of such a file.

    Raises:
        DamagedFile: if it is none.
    """
    kept = read_json(path, ("outcomes",), cure="Delete it: its episodes are played again.")["outcomes"]
    with blaming(path):
        total_steps(kept)
    return kept


def total_steps(outcomes: list[dict[str, Any]]) -> int:
    """Control steps of outcomes."""
    return sum(int(outcome["steps"]) for outcome in outcomes)

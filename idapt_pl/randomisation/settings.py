"""What a config says of randomisation, and the ranges that come with the tasks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.effects import Domain
from idapt_pl.effects.distribution import DomainDistribution, distribution_from
from idapt_pl.files import read_yaml
from idapt_pl.ranges import Range, check_ranges

RANGES = Path(__file__).parent / "ranges"
"""A file of ranges for each of our tasks."""
FOUND = "found"
"""The ranges that the run itself finds: the intervals of the effects that it adds to the source."""


@dataclass(frozen=True)
class RandomisationSettings:
    """What policies train in: the source as it is, or variants of it. Off unless ``ranges`` are given.

    Args:
        ranges: the name of ranges that come with the task (``narrow``, ``paper_narrow``, ``wide``); a YAML file, or its
            content, a list of effects whose parameters are drawn; or ``found``, the intervals of the effects that the
            run finds. None for the source as it is.
        variants: worlds that are drawn and compiled before a policy trains. Every episode begins in one of them.
    """

    ranges: str | list[dict[str, Any]] | None = None
    variants: int = 32

    def __post_init__(self) -> None:
        check_ranges("randomisation", vars(self), {"variants": Range(1, 10_000)})

    def distribution(self, task: str) -> DomainDistribution:
        """What is drawn from for a task, by its name; nothing where that is known later, or never.

        Raises:
            ValueError: if there are no such ranges, or they make no sense.
        """
        if self.ranges in (None, FOUND):
            return DomainDistribution()
        where, entries = self._entries(task)
        try:
            return distribution_from(entries)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None

    def _entries(self, task: str) -> tuple[str, Any]:
        """Where the ranges are from, and what they are."""
        if not isinstance(self.ranges, str):
            return "randomisation.ranges", self.ranges
        known = ranges_of(task)
        if self.ranges in known:
            return f"randomisation.ranges: {self.ranges}", known[self.ranges]
        if not (file := Path(self.ranges)).is_file():
            names = ", ".join([*known, FOUND])
            raise ValueError(
                f"randomisation.ranges is {self.ranges}, which is no file, and {task} has: {names}. Give one of these, "
                "or the path of a YAML file"
            )
        return str(file), read_yaml(file)


def ranges_of(task: str) -> dict[str, Any]:
    """The ranges that come with a task, by their names; none with a task of somebody's own."""
    path = RANGES / f"{task}.yaml"
    return read_yaml(path) if path.exists() else {}


def fill_ranges(randomisation: Any, task: str) -> None:
    """Put the content of the file that a config names in place of its name, so that a run folder needs no other file.

    Args:
        randomisation: what a parser made of the key ``randomisation``; changed in place.
        task: its name.

    Raises:
        ValueError: if the file holds no ranges.
    """
    ranges = randomisation["ranges"]
    if isinstance(ranges, str) and ranges not in (FOUND, *ranges_of(task)) and Path(ranges).is_file():
        RandomisationSettings(ranges).distribution(task)  # what is wrong in it is said with the file's name
        randomisation["ranges"] = read_yaml(Path(ranges))


def draw_variants(distribution: DomainDistribution, source: Domain, number: int, seed: int) -> tuple[Domain, ...]:
    """Variants of the source; none where nothing is drawn.

    Raises:
        ValueError: if a variant cannot be made.
    """
    if not distribution.parts:
        return ()
    rng = np.random.default_rng(seed)
    return tuple(distribution.sample(source, rng) for _ in range(number))

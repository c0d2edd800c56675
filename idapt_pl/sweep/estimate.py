"""How long the rest of a sweep may take, from the runs that are done."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence

from idapt_pl.sweep.plan import PlannedRun

IN_COMMON: tuple[Callable[[PlannedRun], tuple[str, ...]], ...] = (
    lambda run: (run.label, run.target, run.method),
    lambda run: (run.label, run.method),
    lambda run: (run.label, run.target),
    lambda run: (run.label,),
)
"""What runs may have in common, so that one tells how long another takes; what is first is taken first."""


def expected_minutes(run: PlannedRun, known: Mapping[PlannedRun, float]) -> float | None:
    """Minutes of a run by the mean of those that are most like it; None if none is known of its task.

    Args:
        run: that is to be run.
        known: minutes of runs that are done.
    """
    for key in IN_COMMON:
        if found := [minutes for other, minutes in known.items() if key(other) == key(run)]:
            return sum(found) / len(found)
    return None


def minutes_to_the_end(minutes: Sequence[float], slots: int) -> float:
    """Until the last run has ended if each begins, in this order, as soon as one before it has ended.

    Args:
        minutes: of each run.
        slots: how many go side by side.
    """
    ends = [0.0] * max(1, slots)
    for each in minutes:
        heapq.heappush(ends, heapq.heappop(ends) + each)
    return max(ends)

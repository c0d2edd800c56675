"""A diagnosis without the stretches in which the model cannot hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from datamodules import Trajectories
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.stretches.find import find_stretches
from idapt_pl.stretches.stretch import ForecastErrors, Stretch, StretchReport, given_stretches, leave_out

MOST_REPEATS = 2
"""Diagnoses after the first one at most, until what is found is what was left out."""


def diagnose_stretches(
    diagnose: Callable[[Trajectories], Diagnosis], data: Trajectories, conditions: tuple[str, ...] = (),
    look: bool = True, finish: Callable[[Diagnosis], Diagnosis] = lambda found: found,
) -> tuple[Diagnosis, StretchReport]:  # fmt: skip
    """Diagnose recordings; where the model fails for a while, far beyond the rest, leave that out and diagnose again.

    Args:
        diagnose: recordings, to a diagnosis. It must not use steps that ``infos/left_out`` marks.
        data: recordings, with what the user leaves out marked.
        conditions: by which it is marked, for the report.
        look: for more.
        finish: what is done with the last diagnosis alone.

    Returns:
        The diagnosis, and what was left out of it.
    """
    first = last = diagnose(data)
    given = given_stretches(first.sim.data)
    found: list[Stretch] = []
    errors: tuple[ForecastErrors, ...] = ()
    if first.by_forces:  # where every forecast fails, none says where the model cannot hold
        look = False
    for repeat in range(MOST_REPEATS + 1 if look else 0):
        new, errors = find_stretches(last.sim, last.effects)
        new = [s for s in new if not covered(s, given)]
        if same_stretches(new, found) or repeat == MOST_REPEATS:
            break
        found = new
        last = diagnose(leave_out(data, found)) if found else first
    report = StretchReport(
        tuple(sorted([*given, *found], key=lambda s: (s.episode, s.first))),
        sum(map(len, last.sim.data)),
        tuple(float(r.time[-1] - r.time[0]) for r in last.sim.data),
        errors,
        conditions,
    )
    if not found:
        return finish(last), report
    effects = tuple(e.key for e in first.result.effects)
    return finish(last), replace(report, with_them=effects, verdict_with_them=first.verdict.value)


def covered(stretch: Stretch, given: list[Stretch]) -> bool:
    """Whether more than half of a stretch is left out already."""
    both = sum(max(0, min(stretch.last, g.last) - max(stretch.first, g.first)) for g in given
               if g.episode == stretch.episode)  # fmt: skip
    return both > (stretch.last - stretch.first) / 2


def same_stretches(a: list[Stretch], b: list[Stretch]) -> bool:
    """Whether two lists are of the same stretches, give or take their edges."""
    return len(a) == len(b) and all(covered(s, b) for s in a) and all(covered(s, a) for s in b)

"""Tables of a sweep: per cell, over all cells, and one method against another."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.evaluation.paper import PAPER_RESULTS, paper_steps, unlike_the_paper
from idapt_pl.evaluation.statistics import (
    Estimate,
    interquartile_mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
    stratified_bootstrap,
)
from idapt_pl.files import write_atomically
from idapt_pl.sweep.results import CellScale, MethodScores, RunResult, by_cell, cell_scale
from idapt_pl.sweep.settings import SweepSettings

Row = dict[str, Any]
THRESHOLDS = np.linspace(-0.25, 1.25, 61)
"""Scores at which profiles are drawn."""


def generator() -> np.random.Generator:
    """For a bootstrap, so that the same results make the same page."""
    return np.random.default_rng(0)


def columns_of(name: str, estimate: Estimate, runs: int) -> Row:
    """An estimate as columns; of one run a cell there is no interval."""
    ends = (estimate.low, estimate.high) if runs > 1 else (None, None)
    return {name: estimate.value, f"{name}_low": ends[0], f"{name}_high": ends[1]}


def cell_rows(results: Sequence[RunResult], settings: SweepSettings) -> list[Row]:
    """A row for each method of each cell, and one for each of the paper's figures that stands beside it."""
    rows = []
    for cell, mine in by_cell(results).items():
        scale = cell_scale(mine, settings)
        for method in dict.fromkeys(r.run.method for r in mine):
            some = [r for r in mine if r.run.method == method and r.last is not None]
            row: Row = {
                "cell": cell,
                "method": method,
                "metric": mine[0].metric,
                "runs": len(some),
                "source": "this sweep",
            }
            if some:
                last = np.array([r.last for r in some])
                row |= {"direct_transfer": mean_of([r.direct_transfer for r in some])}
                row |= {"step_0": mean_of([r.step_0 for r in some]), "last": float(last.mean())}
                row |= columns_of("iqm", stratified_bootstrap([last], interquartile_mean, generator()), len(some))
                row |= {"score": None if scale.missing else float(interquartile_mean(scale.scores(last)))}
                row |= {"oracle": mean_of([r.oracle for r in some])}
                row |= {"target_interactions": mean_of([r.target_steps for r in some])}
                row |= {"minutes": mean_of([r.minutes for r in some])}
            rows.append(row)
        rows += paper_rows(cell, mine, scale)
    return rows


def paper_rows(cell: str, mine: Sequence[RunResult], scale: CellScale) -> list[Row]:
    """The paper's figures of a cell: of IDAPT, and of methods with the names of ours."""
    run, rows = mine[0].run, []
    steps = float(np.mean([r.target_steps for r in mine]))
    ours = {r.run.method.lower() for r in mine} | {"idapt"}
    for method, value in PAPER_RESULTS.get((run.task, run.target), {}).items():
        if method.lower() in ours:
            of = [r.target_steps for r in mine if r.run.method.lower() == method.lower()]
            why = unlike_the_paper(run.task, run.target, method, float(np.mean(of)) if of else steps)
            rows.append({
                "cell": cell, "method": method, "metric": mine[0].metric, "source": "paper", "last": value,
                "score": None if scale.missing else float(scale.scores(np.array(value))), "note": "; ".join(why),
                "target_interactions": paper_steps(method, run.target),
            })  # fmt: skip
    return rows


def mean_of(values: Sequence[float | None]) -> float | None:
    """Mean of what was measured; None if nothing was."""
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None


def overall_rows(scores: MethodScores) -> list[Row]:
    """A row for each method: aggregates of its scores over all cells, with intervals."""
    rows = []
    for method, cells in scores.scores.items():
        if not cells:
            continue
        most, row = max(map(len, cells)), {"method": method, "cells": len(cells), "runs": sum(map(len, cells))}
        for name, statistic in STATISTICS.items():
            row |= columns_of(name, stratified_bootstrap(cells, statistic, generator()), most)
        rows.append(row)
    return rows


STATISTICS = {"iqm": interquartile_mean, "mean": lambda x: x.mean(-1), "optimality_gap": optimality_gap}
"""Aggregates of scores, by what their columns are called."""


def improvement_rows(scores: MethodScores) -> list[Row]:
    """A row for each pair of methods: how likely a run of the first has more than one of the second."""
    methods, rows = [m for m, cells in scores.scores.items() if cells], []
    for i, first in enumerate(methods):
        for second in methods[i + 1 :]:
            x, y = scores.scores[first], scores.scores[second]
            most = max(map(len, [*x, *y]))
            estimate = probability_of_improvement(x, y, generator())
            rows.append({"first": first, "second": second, **columns_of("probability", estimate, most)})
    return rows


def profiles(scores: MethodScores) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Performance profiles of all methods, with the ends of their bands, at :data:`THRESHOLDS`."""
    return {m: performance_profile(c, THRESHOLDS, generator()) for m, c in scores.scores.items() if c}


def profile_rows(of: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[Row]:
    """Profiles as a table."""
    return [
        {"method": m, "score_above": float(t), "share": float(v), "share_low": float(a), "share_high": float(b)}
        for m, (share, low, high) in of.items()
        for t, v, a, b in zip(THRESHOLDS, share, low, high, strict=True)
    ]


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV: numbers with six digits, nothing where there is none."""
    columns = list(dict.fromkeys(name for row in rows for name in row))

    def told(value: Any) -> Any:
        return "" if value is None else f"{value:.6g}" if isinstance(value, float) else value

    def dump(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as f:
            table = csv.DictWriter(f, columns, lineterminator="\n")
            table.writeheader()
            table.writerows({k: told(v) for k, v in row.items()} for row in rows)

    write_atomically(path, dump)

"""The report of a sweep: one page without scripts, tables as CSV files, figures beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from idapt_pl.evaluation.paper import PAPER_RESULTS
from idapt_pl.files import write_atomically
from idapt_pl.report.html import (
    TONE,
    details,
    document,
    figure,
    header,
    paragraph,
    preformatted,
    row,
    scrollable,
    section,
    table,
    tile,
    tiles,
)
from idapt_pl.report.plots import svg
from idapt_pl.report.run_wording import format_score
from idapt_pl.sweep.figures import cells_figure, profiles_figure, scores_figure
from idapt_pl.sweep.folder import BY_HAND, DONE, FAILED, RunStatus, SweepFolder
from idapt_pl.sweep.plan import PlannedRun
from idapt_pl.sweep.results import MethodScores, RunResult, by_cell, cell_scale, method_scores, read_results
from idapt_pl.sweep.settings import SweepSettings
from idapt_pl.sweep.summaries import (
    Row,
    cell_rows,
    improvement_rows,
    overall_rows,
    profile_rows,
    profiles,
    write_table,
)

PAPER_CSS = "tr.paper td { color: #62666d; font-style: italic; }\n"
"""Marks figures of the paper among ours."""


def write_sweep_report(
    runs: Sequence[PlannedRun],
    statuses: Mapping[PlannedRun, RunStatus],
    folder: SweepFolder,
    settings: SweepSettings,
    path: Path | None = None,
) -> Path:
    """Write ``report.html``, ``tables/*.csv`` and ``figures/*.svg`` of a sweep, finished or not. Returns the page.

    Args:
        runs: of the sweep.
        statuses: how far they are.
        folder: of the sweep.
        settings: of the sweep.
        path: of the page; ``report.html`` in the folder if left out.
    """
    results = read_results(runs, statuses, folder)
    scores = method_scores(results, settings)
    cells, overall, better = cell_rows(results, settings), overall_rows(scores), improvement_rows(scores)
    curves = profiles(scores)
    tables = {
        "runs": [r.to_row() for r in results],
        "cells": cells,
        "scores": overall,
        "improvement": better,
        "profiles": profile_rows(curves),
    }
    banded = any(len(c) > 1 for mine in scores.scores.values() for c in mine)
    figures = {"cells": cells_figure(by_cell(results), paper_lines(results))} if results else {}
    if overall:
        figures |= {"scores": scores_figure(overall), "profiles": profiles_figure(curves, banded)}
    for name, rows in tables.items():
        write_table(folder.path / "tables" / f"{name}.csv", rows)
    drawn = {name: svg(made) for name, made in figures.items()}
    for name, made in figures.items():
        write_figure(folder.path / "figures" / f"{name}.svg", made)
    parts = [outcome(runs, statuses, results, overall, scores)]
    parts += [failures_section(statuses, folder), scores_section(overall, better, scores, drawn)]
    parts += [cells_section(cells, results, settings, drawn), runs_section(runs, statuses, results)]
    text = document(f"Sweep {folder.path.name}", parts, TONE, PAPER_CSS)
    path = path or folder.path / "report.html"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return path


def write_figure(path: Path, made: Figure) -> None:
    """Write a figure as SVG."""
    write_atomically(path, lambda temporary: made.savefig(temporary, format="svg", metadata={"Date": None}))


def paper_lines(results: Sequence[RunResult]) -> dict[str, float]:
    """IDAPT in the paper, by cell."""
    known = {cell: PAPER_RESULTS.get((mine[0].run.task, mine[0].run.target)) for cell, mine in by_cell(results).items()}
    return {cell: entries["IDAPT"] for cell, entries in known.items() if entries}


def estimate_in_words(row_of: Row, key: str) -> str:
    """``0.93 (0.81 to 1.00)``; without an interval where there is none."""
    low, high = row_of[f"{key}_low"], row_of[f"{key}_high"]
    return f"{row_of[key]:.2f}" + ("" if low is None else f" ({low:.2f} to {high:.2f})")


def outcome(
    runs: Sequence[PlannedRun],
    statuses: Mapping[PlannedRun, RunStatus],
    results: Sequence[RunResult],
    overall: Sequence[Row],
    scores: MethodScores,
) -> str:
    """The headline, and the numbers that matter."""
    counts = {state: sum(s.state == state for s in statuses.values()) for state in (DONE, FAILED, BY_HAND)}
    head = f"{counts[DONE]} of {len(runs)} runs are done"
    if overall:
        head = f"{overall[0]['method']}: {estimate_in_words(overall[0], 'iqm')} of the way to the reference"
    made = [tile(estimate_in_words(r, "iqm"), f"{r['method']}, score", "best" * (i == 0))
            for i, r in enumerate(overall)]  # fmt: skip
    made += [tile(f"{counts[DONE]} of {len(runs)}", "runs done"), tile(str(counts[FAILED]), "failed for good")]
    made += [tile(f"{sum(r.minutes for r in results) / 60:.1f} h", "all runs together")]
    about = (
        "A score is 0 at direct transfer and 1 at the reference of its cell (below). Scores of methods are "
        f"interquartile means over the runs of {len(scores.cells)} cells, with 95 % intervals by stratified bootstrap "
        "over seeds."
        if overall
        else "There are no scores yet: they need a run of every method in one cell, and a reference of that cell."
    )
    note = "Returns in the target are for evaluation only: nothing in a run was trained or selected on them."
    commits = ", ".join(dict.fromkeys(short(r.commit) for r in results))
    return header(
        head, tiles(*made), paragraph(about), paragraph(note, "small"), note=f"commits: {commits or 'none yet'}"
    )


def short(commit: str) -> str:
    """The first characters of a commit, marked where files had been changed."""
    return (commit[:7] + "+" * commit.endswith("dirty")) if commit else "unknown"


def failures_section(statuses: Mapping[PlannedRun, RunStatus], folder: SweepFolder) -> str:
    """Runs that failed, for good or before they were done, with their last lines."""
    parts = []
    for run, status in statuses.items():
        if status.failures:
            last = status.failures[-1]
            kind = "failed for good" if status.state == FAILED else f"failed, now {status.state}"
            times = f"{len(status.failures)} failed attempt" + "s" * (len(status.failures) > 1)
            title = f"{run.name}: {kind}; {times}, the last with exit code {last['code']} on {last['host']}"
            parts += [
                paragraph(title),
                preformatted("\n".join(last["lines"])),
                paragraph(str(folder.log(run.name)), "small"),
            ]
    waiting = [run.name for run, status in statuses.items() if status.state == BY_HAND]
    if waiting:
        parts.append(paragraph(f"Waiting for recordings by hand: {', '.join(waiting)}."))
    return section("Failures", *parts) if parts else ""


def scores_section(
    overall: Sequence[Row], better: Sequence[Row], scores: MethodScores, drawn: Mapping[str, str]
) -> str:
    """Scores over all cells."""
    left = [paragraph(f"{cell} is left out: {why}.", "small") for cell, why in scores.left_out.items()]
    if not overall:
        return section("Over all cells", *left) if left else ""
    rows = [
        row(r["method"], f"#{r['cells']}", f"#{r['runs']}", *(f"#{estimate_in_words(r, key)}" for key in NAMED))
        for r in overall
    ]
    heads = ("method", "#cells", "#runs", *(f"#{name}" for name in NAMED.values()))
    parts = [table(heads, rows), figure(scrollable(drawn["scores"]), "Bars are 95 % intervals.")]
    parts.append(figure(scrollable(drawn["profiles"]), "Performance profiles: each cell counts the same."))
    if better:
        told = [row(r["first"], r["second"], "#" + estimate_in_words(r, "probability"))
                for r in better]  # fmt: skip
        parts.append(table(("a run of", "has more than one of", "#probability"), told))
        parts.append(paragraph("Probability of improvement, in a cell drawn at random; ties count half.", "small"))
    return section("Over all cells", *parts, *left)


NAMED = {"iqm": "interquartile mean", "mean": "mean", "optimality_gap": "optimality gap"}
"""Columns of the table of scores."""


def cells_section(
    cells: Sequence[Row], results: Sequence[RunResult], settings: SweepSettings, drawn: Mapping[str, str]
) -> str:
    """Results in their own units, cell by cell, with the paper's beside them."""
    if not results:
        return ""
    caption = (
        "A dot is a run, a dash its direct transfer; dotted: IDAPT in the paper; dashed: the oracle of this sweep."
    )
    parts = [figure(scrollable(drawn["cells"]), caption)]
    for cell, mine in by_cell(results).items():
        rows = [cell_row(r) for r in cells if r["cell"] == cell]
        heads = (
            "",
            "#runs",
            "#direct transfer",
            "#step 0",
            "#last step",
            "#interquartile mean",
            "#score",
            "#target steps",
        )
        scale = cell_scale(mine, settings)
        units = (
            f"No score: {scale.missing}."
            if scale.missing
            else f"Score 0 is {scale.zero:.4g} (direct transfer, {scale.zero_from}), "
            f"1 is {scale.one:.4g} ({scale.one_from})."
        )
        notes = [f"{r['method']} in the paper is not like for like: {r['note']}." for r in cells
                 if r["cell"] == cell and r.get("note")]  # fmt: skip
        title = f"{cell}: {mine[0].metric}, mean of {mine[0].episodes} episodes a run"
        parts += [paragraph(title), table(heads, rows), *(paragraph(t, "small") for t in (units, *notes))]
    return section("Cell by cell", *parts)


def cell_row(r: Row) -> str:
    """A method, or a figure of the paper."""
    metric = r["metric"]

    def told(key: str) -> str:
        return "#-" if r.get(key) is None else f"#{format_score(r[key], metric)}"

    iqm = told("iqm")
    if r.get("iqm_low") is not None:
        iqm += f" ({format_score(r['iqm_low'], metric)} to {format_score(r['iqm_high'], metric)})"
    score = "#-" if r.get("score") is None else f"#{r['score']:.2f}"
    steps = "#-" if r.get("target_interactions") is None else f"#{r['target_interactions']:,.0f}"
    paper = r["source"] == "paper"
    return row(
        r["method"] + " in the paper *" * paper, "#" + ("-" if paper else str(r["runs"])), told("direct_transfer"),
        told("step_0"), told("last"), iqm, score, steps, kind="paper" * paper,
    )  # fmt: skip


def runs_section(
    runs: Sequence[PlannedRun], statuses: Mapping[PlannedRun, RunStatus], results: Sequence[RunResult]
) -> str:
    """Every run, folded away."""
    had = {r.run: r for r in results}
    rows = []
    for run in runs:
        r = had.get(run)
        after = [] if r is None else [*r.steps] or [r.last]
        told = ", ".join("not measured" if v is None else format_score(v, r.metric) for v in after) if r else ""
        minutes, commit, cpu = (f"#{r.minutes:.1f}", short(r.commit), f"{r.cpu}; {r.host}") if r else ("#-", "", "")
        rows.append(row(f"#{run.index}", run.name, statuses[run].state, told, minutes, commit, cpu))
    heads = ("#", "run", "state", "after each step", "#minutes", "commit", "machine")
    where = paragraph("Each run's own story is in runs/RUN/report.html, its log in logs/RUN.log.", "small")
    return section("Runs", details(f"All {len(runs)} runs", table(heads, rows)), where)

"""A sweep as one table in a terminal: how far each run is, what it had, how long the rest may take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from idapt_pl.files import DamagedFile, read_json
from idapt_pl.run_folder.time_left import in_words
from idapt_pl.sweep.estimate import expected_minutes, minutes_to_the_end
from idapt_pl.sweep.folder import BY_HAND, DONE, FAILED, RUNNING, WAITING, RunStatus, SweepFolder, last_stage
from idapt_pl.sweep.plan import PlannedRun
from idapt_pl.sweep.results import last_result

COLOURS = {DONE: "green", RUNNING: "cyan", FAILED: "red", BY_HAND: "yellow", WAITING: "dim"}
LONGEST_TABLE = 40
"""Rows of a table; of a longer one, what runs and what failed are shown, and how many others there are."""


@dataclass(frozen=True)
class SweepProgress:
    """How far a sweep is.

    Attributes:
        statuses: of every run, in order.
        minutes: of the runs that are done.
        results: of the runs that are done, the metric of the last policy in the target; None where it is not measured.
    """

    statuses: dict[PlannedRun, RunStatus]
    minutes: dict[PlannedRun, float]
    results: dict[PlannedRun, float | None]

    def of(self, state: str) -> list[PlannedRun]:
        """The runs that are so far."""
        return [run for run, status in self.statuses.items() if status.state == state]

    def minutes_left(self, slots: int) -> tuple[float, int]:
        """Minutes to the end, of runs that are like one that is done; and how many others there are."""
        ahead = [expected_minutes(run, self.minutes) for run in (*self.of(RUNNING), *self.of(WAITING))]
        known = [minutes for minutes in ahead if minutes is not None]
        return minutes_to_the_end(known, slots), len(ahead) - len(known)


def read_progress(runs: Sequence[PlannedRun], folder: SweepFolder, seen: SweepProgress | None = None) -> SweepProgress:
    """How far a sweep is, from its files.

    Args:
        runs: of the sweep.
        folder: of the sweep.
        seen: what was read before; done runs are not read again.
    """
    done = seen.minutes if seen else {}
    statuses = {run: seen.statuses[run] if seen and run in done else folder.status(run.name) for run in runs}
    minutes, results = dict(done), dict(seen.results) if seen else {}
    for run in runs:
        if statuses[run].state == DONE and run not in minutes:
            try:
                summary = read_json(folder.run(run.name) / "summary.json", ("wall_s", "visual_only", "grounded"))
            except DamagedFile:
                continue
            minutes[run] = summary["wall_s"] / 60
            results[run] = last_result(summary)
    return SweepProgress(statuses, minutes, results)


def sweep_table(progress: SweepProgress, folder: SweepFolder, slots: int) -> Group:
    """The table and, below it, the counts."""
    table = Table("#", "run", "state", "at", "minutes", "result", title=f"sweep in {escape(str(folder.path))}")
    for column in (0, 4, 5):
        table.columns[column].justify = "right"
    shown = list(progress.statuses)
    if len(shown) > LONGEST_TABLE:
        shown = [run for state in (RUNNING, FAILED, BY_HAND) for run in progress.of(state)][:LONGEST_TABLE]
    for run in shown:
        table.add_row(*cells(run, progress, folder))
    return Group(table, escape(counts(progress, slots)))


def cells(run: PlannedRun, progress: SweepProgress, folder: SweepFolder) -> list[str]:
    """A row of the table."""
    status, minutes, result = progress.statuses[run], progress.minutes.get(run), progress.results.get(run)
    at = last_stage(folder.run(run.name)) if status.state in (RUNNING, WAITING) else ""
    tries = len(status.failures) + (status.state == RUNNING)
    state = f"[{COLOURS[status.state]}]{status.state}[/]" + (f", attempt {tries}" if tries > 1 else "")
    told = "" if minutes is None else f"{minutes:.1f}"
    return [str(run.index), escape(run.name), state, escape(at), told, "" if result is None else f"{result:.4g}"]


def counts(progress: SweepProgress, slots: int) -> str:
    """How many runs are how far, and how long the rest may take."""
    told = [f"{len(found)} {state}" for state in COLOURS if (found := progress.of(state))]
    line = f"{len(progress.statuses)} runs: {', '.join(told)}"
    if not progress.of(RUNNING) and not progress.of(WAITING):
        return line
    minutes, unknown = progress.minutes_left(slots)
    if minutes:
        line += f". About {in_words(60 * minutes)} with {slots} side by side, by runs that are done"
        line += f"; {unknown} more of tasks of which none is done yet" if unknown else ""
    return line + "."


def dry_run_table(progress: SweepProgress, folder: SweepFolder, slots: int) -> Group:
    """What would run, and how long each may take."""
    table = Table("index", "run", "state", "minutes", title=f"would run in {escape(str(folder.path))}")
    table.columns[0].justify = table.columns[3].justify = "right"
    for run, status in progress.statuses.items():
        known = progress.minutes.get(run)
        expected = expected_minutes(run, progress.minutes) if known is None else None
        told = f"{known:.1f}" if known is not None else "?" if expected is None else f"about {expected:.1f}"
        table.add_row(str(run.index), escape(run.name), status.state, told)
    return Group(table, escape(counts(progress, slots)))


def failed_lines(statuses: Mapping[PlannedRun, RunStatus], folder: SweepFolder) -> list[str]:
    """What runs that failed for good said last, and where the rest is."""
    lines = []
    for run, status in statuses.items():
        if status.state == FAILED and status.failures:
            last = status.failures[-1]
            times = f"{len(status.failures)} times, last " if len(status.failures) > 1 else ""
            lines.append(f"{run.name} failed {times}with exit code {last['code']} on {last['host']}:")
            lines += [f"    {line}" for line in last["lines"]]
            lines.append(f"    all of it: {folder.log(run.name)}")
    return lines


def brought_by_hand(statuses: Mapping[PlannedRun, RunStatus], folder: SweepFolder) -> list[str]:
    """Which runs wait for recordings, and where it is said which."""
    return [f"{run.name} waits for recordings: {told(folder.log(run.name))}" for run, status in statuses.items()
            if status.state == BY_HAND]  # fmt: skip


def told(log: Path) -> str:
    """The last line of a log."""
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()] if log.exists() else []
    return lines[-1] if lines else "it did not say which"

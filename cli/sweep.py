"""``idapt sweep``: tasks x targets x methods x seeds from one YAML, on the cores of this machine or on a Ray cluster.

Every run is an `idapt fit` in a folder of its own, and goes on where it was: the same command continues a sweep that
was stopped or killed. A run that fails is tried again (`retries`), then listed with its last lines.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import yaml
from rich.console import Console
from rich.live import Live

from cli.arguments import parser, show_bar
from cli.fit import GroundingCLI, current
from cli.interrupt import Interrupted
from idapt_pl.run_folder.shipped_configs import config_path
from idapt_pl.sweep.folder import BY_HAND, DONE, FAILED, RUNNING, SweepFolder
from idapt_pl.sweep.plan import PlannedRun, plan_sweep
from idapt_pl.sweep.report import write_sweep_report
from idapt_pl.sweep.runner import LocalRunner, local_slots, visible_devices
from idapt_pl.sweep.settings import SweepSettings, read_sweep
from idapt_pl.sweep.table import (
    SweepProgress,
    brought_by_hand,
    counts,
    dry_run_table,
    failed_lines,
    read_progress,
    sweep_table,
)
from idapt_pl.sweep.work import SweepWorker
from idapt_pl.usable_cores import usable_cores

EXAMPLES = """examples:
  idapt sweep --config configs/sweeps/pendulum.yaml --dry-run      # what would run; and how long, once runs are done
  idapt sweep --config configs/sweeps/pendulum.yaml                # run it; the same command goes on
  idapt sweep status --folder runs/sweeps/pendulum                 # how far it is
  idapt sweep report --folder runs/sweeps/pendulum                 # tables and report.html
  idapt sweep --config sweep.yaml --index $SLURM_ARRAY_TASK_ID     # one run, for an array of jobs
  idapt sweep --config sweep.yaml --address auto                   # on a Ray cluster (pip install 'idapt[ray]')"""

ACTIONS = ("run", "status", "report")
WAITS = 3
"""Exit code where runs wait for recordings, as of ``idapt fit``."""


class Runner(Protocol):
    """Carries out runs, here or elsewhere."""

    def run(self, names: Sequence[str], tick: Callable[[], None]) -> None:
        """Carry them out."""

    def stop(self) -> None:
        """End what is running."""


def main(args: list[str]) -> int:
    """Run ``idapt sweep``. Returns 1 if runs have failed, 3 if some wait for recordings."""
    p = parser("sweep", __doc__, EXAMPLES)
    p.add_argument("action", nargs="?", choices=ACTIONS, default="run", help="what to do")
    p.add_argument("--config", type=config_path, help="YAML of the sweep")
    p.add_argument("--folder", type=Path, help="folder of the sweep, in place of the YAML's; alone, one that was begun")
    p.add_argument("--dry-run", action="store_true", help="say what would run, and run nothing")
    p.add_argument("--index", type=int, help="carry out this one run, counted from 0")
    p.add_argument("--address", help="of a Ray cluster: auto, local, HOST:PORT or ray://HOST:PORT; here if left out")
    p.add_argument("--retry", action="store_true", help="try runs again that have failed for good")
    p.add_argument("--out", type=Path, help="page that `report` writes; FOLDER/report.html if left out")
    o = p.parse_args(args)
    check_options(o)
    settings = settings_of(o)
    folder = SweepFolder(settings.folder)
    if o.action == "run":
        return run_sweep(settings, folder, o)
    if not folder.yaml.is_file():
        raise ValueError(f"{folder.path} holds no sweep; idapt sweep --config YAML begins one")
    runs = planned_now(settings, folder)
    progress = read_progress(runs, folder)
    if o.action == "report":
        print(write_sweep_report(runs, progress.statuses, folder, settings, o.out))
        return 0
    slots = max(len(progress.of(RUNNING)), 1)
    show_outcome(Console(), progress, folder, slots)
    return 0


def planned_now(settings: SweepSettings, folder: SweepFolder) -> list[PlannedRun]:
    """The runs that the YAML says now: jobs of an array keep no plan, and may have been given more than an old one has.

    Where its configs cannot be found any more, or not from here, the runs of the plan.
    """
    try:
        return plan_sweep(settings, folder, complete_config, write=False)
    except ValueError:
        if planned := folder.read_plan():
            return planned
        raise


def check_options(o: argparse.Namespace) -> None:
    """Refuse options that say nothing together.

    Raises:
        ValueError: naming them.
    """
    if o.config is None and o.folder is None:
        raise ValueError("give --config, the YAML of a sweep, or --folder, that of one that was begun")
    given = [
        f"--{k.replace('_', '-')}"
        for k in ("dry_run", "index", "address", "retry")
        if getattr(o, k) not in (None, False)
    ]
    if o.action != "run" and given:
        raise ValueError(f"{', '.join(given)}: of `idapt sweep` alone, not of `idapt sweep {o.action}`")
    if o.index is not None and o.address is not None:
        raise ValueError("--index carries out one run here; leave --address out")
    if o.out is not None and o.action != "report":
        raise ValueError("--out: of `idapt sweep report` alone")
    if o.out is not None and o.out.exists() and o.out.suffix != ".html":
        raise ValueError(f"{o.out}: --out is there already and is no page; name an .html file")


def settings_of(o: argparse.Namespace) -> SweepSettings:
    """What the sweep's YAML says, or that which the folder keeps."""
    if o.config is not None:
        return read_sweep(o.config, o.folder)
    kept = SweepFolder(o.folder).yaml
    if not kept.is_file():
        raise ValueError(f"{o.folder} is no folder of a sweep: it has no sweep.yaml; give --config")
    return read_sweep(kept, o.folder)


def complete_config(arguments: list[str]) -> dict[str, Any]:
    """The complete config that arguments of ``idapt fit`` make, once the run has been opened with it."""
    cli = GroundingCLI([current(a) for a in arguments], shows_bars=False)
    cli.run(aside=lambda name, last, work: work)
    return yaml.safe_load(cli.parser.dump(cli.config, skip_none=False))


def run_sweep(settings: SweepSettings, folder: SweepFolder, o: argparse.Namespace) -> int:
    """Plan, check, and run."""
    console = Console(stderr=True)
    with console.status("checking every task, target and method"):
        runs = plan_sweep(settings, folder, complete_config, o.index, write=not o.dry_run)
    if o.index is not None:
        runs = [runs[o.index]]
    slots = local_slots(settings.resources, usable_cores(), visible_devices() if settings.resources.gpus else [])
    if o.dry_run:
        Console().print(dry_run_table(read_progress(runs, folder), folder, len(slots)))
        return 0
    folder.keep_yaml(o.config or folder.yaml)
    if o.retry:
        for run in runs:
            folder.forget_failures(run.name)
    worker = SweepWorker(folder, settings.resources, settings.retries)
    runner: Runner = LocalRunner(worker, slots)
    side_by_side = len(slots)
    if o.address is not None:
        from idapt_pl.sweep.ray_runner import RayRunner

        runner = RayRunner(worker, o.address, settings.storage)
        side_by_side = runner.side_by_side
    progress = carry_out_shown(runner, runs, folder, console, side_by_side)
    if o.index is None:
        print(write_sweep_report(folder.read_plan(), progress.statuses, folder, settings))
    return 1 if progress.of(FAILED) else WAITS if progress.of(BY_HAND) else 0


def carry_out_shown(
    runner: Runner, runs: Sequence[PlannedRun], folder: SweepFolder, console: Console, slots: int
) -> SweepProgress:
    """Carry out what is not done, with a table where a person watches, else with a line for each change."""
    progress, shown_at = read_progress(runs, folder), 0.0

    def look(live: Live | None) -> None:
        nonlocal progress, shown_at
        if time.monotonic() - shown_at < 2:
            return
        before, progress = progress, read_progress(runs, folder, progress)
        shown_at = time.monotonic()
        if live is not None:
            live.update(sweep_table(progress, folder, slots))
        else:
            say_changes(before, progress, slots)

    ahead = [run.name for run in runs if progress.statuses[run].state != DONE]
    with stoppable(runner, folder):
        if show_bar():
            with Live(sweep_table(progress, folder, slots), console=console, refresh_per_second=2) as live:
                runner.run(ahead, lambda: look(live))
        else:
            runner.run(ahead, lambda: look(None))
    progress = read_progress(runs, folder)
    show_outcome(console, progress, folder, slots)
    return progress


def say_changes(before: SweepProgress, now: SweepProgress, slots: int) -> None:
    """A line for each run whose state has changed."""
    for run, status in now.statuses.items():
        if status.state != before.statuses[run].state:
            print(f"{run.name}: {status.state}. {counts(now, slots)}", file=sys.stderr, flush=True)


def show_outcome(console: Console, progress: SweepProgress, folder: SweepFolder, slots: int) -> None:
    """The table, and what has failed or waits for a person."""
    console.print(sweep_table(progress, folder, slots))
    for line in (*failed_lines(progress.statuses, folder), *brought_by_hand(progress.statuses, folder)):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    if progress.of(FAILED):
        again = f"idapt sweep --folder {folder.path} --retry"
        console.print(f"To try what failed again: {again}", soft_wrap=True, markup=False, highlight=False)


@contextmanager
def stoppable(runner: Runner, folder: SweepFolder) -> Iterator[None]:
    """Ctrl-C and SIGTERM end all runs, each of which keeps its finished stages; the line says how to go on."""
    try:
        yield
    except Interrupted as interrupted:
        signal.setitimer(signal.ITIMER_REAL, 0)  # it was heard; what follows may take as long as runs take to leave
        print("stopping: each run ends where it is ...", file=sys.stderr, flush=True)
        runner.stop()
        interrupted.kept = f"finished stages are kept in {folder.path}, go on with: idapt sweep --folder {folder.path}"
        raise

"""The final table of a run."""

from __future__ import annotations

import shlex
from pathlib import Path

from rich.console import Console
from rich.table import Table

from idapt_pl.report.run_wording import format_score
from idapt_pl.run_folder.kept_warnings import read_warnings
from idapt_pl.stages.shortened import shortened_sentence

NAMES = {"idapt": "IDAPT", "cc_state": "CC-State", "cc_image": "CC-Image"}
"""Of the methods that have grounding steps, as the paper has them."""


def print_summary(summary: dict, run_dir: Path, report: Path) -> None:
    """Print the references and every grounding step.

    Args:
        summary: of the run, as in its ``summary.json``.
        run_dir: its folder.
        report: its page.
    """
    table = Table(title=f"{summary['task']}: source -> {summary['target']} (seed {summary['seed']})")
    table.add_column("policy")
    table.add_column(f"target {summary['metric']}, mean of {summary['episodes']} episodes", justify="right")
    for name, value in measured_policies(summary):
        table.add_row(name, value)
    console = Console()
    console.print(table)
    if worth := shortened_sentence(summary["shortened_by"]):
        console.print(worth)
    console.print(
        f"target interactions used: {summary['target_interactions']}   time: {summary['wall_s'] / 60:.1f} min"
    )
    for e in summary["effects"]:
        values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in e["parameters"].items())
        console.print(f"added to the source in step {e['step']}: {e['effect']} of {e['target']}, {values}")
    if summary["settled"]:
        console.print(f"settled: step {summary['settled']} showed nothing left to learn, the policy before it stays")
    if summary["rolled_back"]:
        console.print(f"rolled back: grounding step {', '.join(map(str, summary['rolled_back']))}")
    for said in told_warnings(run_dir):
        console.print(f"warned: {said}", soft_wrap=True, markup=False, highlight=False)
    console.print(f"the story of the run: {report}", soft_wrap=True)
    watch = f"tensorboard --logdir {shlex.quote(str(run_dir))}"
    console.print(f"everything is in {run_dir}; watch it with: {watch}", soft_wrap=True)


def told_warnings(run_dir: Path) -> list[str]:
    """What a run warned of, or why that cannot be read: it has ended all the same."""
    try:
        return read_warnings(run_dir)
    except ValueError as error:
        return [str(error)]


def measured_policies(summary: dict) -> list[tuple[str, str]]:
    """Names and returns, or shares of successes, of what a run measured, in its order."""

    def told(value: float | None) -> str:
        return "not measured" if value is None else format_score(value, summary["metric"])

    oracle = [] if summary["oracle"] is None else [("oracle", told(summary["oracle"]))]
    if summary["method"] == "oracle":
        return oracle
    direct = ("direct transfer", told(summary["direct_transfer"]))
    if summary["method"] == "source":
        return [direct, *oracle]
    repaired = any(e["step"] == 0 for e in summary["effects"])
    rows = [direct, (f"visual grounding{', source repaired' if repaired else ' only'}", told(summary["visual_only"]))]
    for k, value in enumerate(summary["grounded"], 1):
        same = " (settled)" if k == summary["settled"] else ""
        rows.append((f"{NAMES[summary['method']]}, grounding step {k}{same}", told(value)))
    return [*rows, *oracle]

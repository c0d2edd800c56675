"""What the runs of a sweep had in the target, and the scores that make cells comparable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idapt_pl.evaluation.paper import PAPER_RESULTS
from idapt_pl.files import read_json
from idapt_pl.randomisation import FOUND
from idapt_pl.run_folder.interactions import ORACLE
from idapt_pl.run_folder.kept_config import read_run_json
from idapt_pl.sweep.folder import DONE, RunStatus, SweepFolder
from idapt_pl.sweep.plan import PlannedRun
from idapt_pl.sweep.settings import SweepSettings

STEPLESS = ("source", "oracle")
"""Methods (:data:`~idapt_pl.run_config.METHOD_NAMES`) without grounding steps."""

LEAST_GAP = 0.05
"""Of the larger of the two: a gap between direct transfer and the reference that is worth to be measured in."""


@dataclass(frozen=True)
class RunResult:
    """What a run had in the target, for evaluation only; None where it was not measured.

    Attributes:
        run: which.
        metric: return or success.
        episodes: of each mean.
        direct_transfer: of the source's policy; None where that policy is what the run is about.
        steps: of the policy after each step, from step 0 on; empty where there are none, as of randomised sources.
        last: of what the run ended with.
        oracle: of SAC in the target, if it was trained.
        target_steps: control steps in the target that training took.
        minutes: of all stages.
        commit, cpu, host: where it comes from.
    """

    run: PlannedRun
    metric: str
    episodes: int
    direct_transfer: float | None
    steps: tuple[float | None, ...]
    last: float | None
    oracle: float | None
    target_steps: int
    minutes: float
    commit: str
    cpu: str
    host: str

    @property
    def step_0(self) -> float | None:
        """Of the policy after step 0; None where there was no such step, or it was not measured."""
        return self.steps[0] if self.steps else None

    def to_row(self) -> dict[str, Any]:
        """For a table."""
        return {
            "task": self.run.label, "target": self.run.target, "method": self.run.method, "seed": self.run.seed,
            "metric": self.metric, "episodes": self.episodes, "direct_transfer": self.direct_transfer,
            "step_0": self.step_0, "last": self.last, "grounding_steps": max(0, len(self.steps) - 1),
            "oracle": self.oracle,
            "target_interactions": self.target_steps, "minutes": round(self.minutes, 1), "commit": self.commit,
            "cpu": self.cpu, "host": self.host,
        }  # fmt: skip


@dataclass(frozen=True)
class CellScale:
    """What scores of a cell are measured in: 0 is direct transfer, 1 a reference.

    Attributes:
        zero, one: in units of the metric.
        zero_from, one_from: where they come from, in words.
        missing: why there are no scores; empty if there are.
    """

    zero: float = 0.0
    one: float = 1.0
    zero_from: str = ""
    one_from: str = ""
    missing: str = ""

    def scores(self, values: np.ndarray) -> np.ndarray:
        """Results as scores."""
        return np.asarray((values - self.zero) / (self.one - self.zero))


def read_results(
    runs: Sequence[PlannedRun], statuses: Mapping[PlannedRun, RunStatus], folder: SweepFolder
) -> list[RunResult]:
    """Results of the runs that are done.

    Raises:
        DamagedFile: if a run's files cannot be read.
    """
    return [read_result_of(run, statuses[run], folder) for run in runs if statuses[run].state == DONE]


def read_result_of(run: PlannedRun, status: RunStatus, folder: SweepFolder) -> RunResult:
    """The result of one run."""
    keys = (
        "metric",
        "episodes",
        "direct_transfer",
        "visual_only",
        "grounded",
        "oracle",
        "target_interactions",
        "wall_s",
    )
    path = folder.run(run.name)
    s, told = read_json(path / "summary.json", keys), read_run_json(path)
    steps = (s["visual_only"], *s["grounded"]) if s.get("method") not in STEPLESS else ()
    direct = s["direct_transfer"] if is_plain(told.get("config") or {}) else None
    used = s["target_interactions"] + steps_of_oracle(path) * (s.get("method") == "oracle")
    return RunResult(
        run, s["metric"], s["episodes"], direct, steps, last_result(s), s["oracle"], used, s["wall_s"] / 60,
        str(told.get("git_commit") or ""), str(told.get("cpu") or ""), status.host,
    )  # fmt: skip


def last_result(summary: Mapping[str, Any]) -> float | None:
    """What a run ended with, from its ``summary.json``; runs of before there was ``result`` ended with their last step.

    Args:
        summary: as :meth:`~idapt_pl.evaluation.evaluation.Evaluation.summary` has it.
    """
    value = summary.get("result", [summary["visual_only"], *summary["grounded"]][-1])
    return None if value is None else float(value)


def is_plain(config: Mapping[str, Any]) -> bool:
    """Whether the policy that a run calls direct transfer is one of the source as it is, and has no memory."""
    ranges = (config.get("randomisation") or {}).get("ranges")
    return ranges in (None, FOUND) and not (config.get("policy") or {}).get("recurrent")


def steps_of_oracle(path: Path) -> int:
    """Control steps in the target that the oracle of a run trained for."""
    entries = read_json(path / "ledger.json", ("entries",))["entries"] if (path / "ledger.json").exists() else []
    return sum(e["count"] for e in entries if e["purpose"] == ORACLE)


def by_cell(results: Sequence[RunResult]) -> dict[str, list[RunResult]]:
    """Results that are compared within, by cell, in order."""
    found: dict[str, list[RunResult]] = {}
    for result in results:
        found.setdefault(result.run.cell, []).append(result)
    return found


def cell_scale(mine: Sequence[RunResult], settings: SweepSettings) -> CellScale:
    """What a cell's scores are measured in.

    Direct transfer is what ``references`` say, else the mean over the cell's runs that have a policy of the plain
    source: of those that went on to ground it, if there are any, as others train it for longer. The reference is the
    oracle that ``references`` say or that the runs trained, or IDAPT in the paper: first what ``normalise`` names.

    Args:
        mine: results of one cell.
        settings: of the sweep.
    """
    run = mine[0].run
    given = settings.references.get(run.cell) or settings.references.get(f"{run.task}/{run.target}") or {}
    plain = [(r, r.direct_transfer) for r in mine if r.direct_transfer is not None]
    direct = [v for r, v in plain if r.steps] or [v for _, v in plain]
    zero, zero_from = given.get("direct_transfer"), "by the sweep's references"
    if zero is None and direct:
        zero, zero_from = float(np.mean(direct)), f"mean of {len(direct)} runs"
    oracles = [r.oracle for r in mine if r.oracle is not None]
    oracle, oracle_from = given.get("oracle"), "oracle, by the sweep's references"
    if oracle is None and oracles:
        oracle, oracle_from = float(np.mean(oracles)), f"oracle, mean of {len(oracles)} runs"
    paper = PAPER_RESULTS.get((run.task, run.target), {}).get("IDAPT")
    choices = [(oracle, oracle_from), (paper, "IDAPT in the paper")]
    if settings.normalise == "paper":
        choices.reverse()
    one, one_from = next(((v, said) for v, said in choices if v is not None), (None, ""))
    if zero is None or one is None:
        lacks = (
            "direct transfer was not measured" if zero is None else "there is no oracle (--oracle true, or references)"
        )
        return CellScale(missing=lacks)
    if one - zero <= LEAST_GAP * max(abs(one), abs(zero)):
        return CellScale(missing=f"direct transfer has {zero:.4g} already, the reference {one:.4g} ({one_from})")
    return CellScale(zero, one, zero_from, one_from)


@dataclass(frozen=True)
class MethodScores:
    """Scores of all methods in the cells that they share.

    Attributes:
        cells: names, in order.
        scores: method to an array for each cell, one score a run.
        left_out: cells without scores, and why.
    """

    cells: list[str]
    scores: dict[str, list[np.ndarray]]
    left_out: dict[str, str]


def method_scores(results: Sequence[RunResult], settings: SweepSettings) -> MethodScores:
    """Scores of what each run ended with, in cells that have a scale and runs of every method."""
    methods = list(dict.fromkeys(r.run.method for r in results))
    scores: dict[str, list[np.ndarray]] = {m: [] for m in methods}
    cells, left_out = list[str](), dict[str, str]()
    for cell, mine in by_cell(results).items():
        scale = cell_scale(mine, settings)
        had = {m: np.array([r.last for r in mine if r.run.method == m and r.last is not None]) for m in methods}
        if scale.missing:
            left_out[cell] = scale.missing
        elif lacking := [m for m, values in had.items() if not len(values)]:
            left_out[cell] = f"no run of {', '.join(lacking)} is done"
        else:
            cells.append(cell)
            for m, values in had.items():
                scores[m].append(scale.scores(values))
    return MethodScores(cells, scores, left_out)

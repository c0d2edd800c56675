"""What a run folder says, finished or not: everything may be missing but the config."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import yaml

ORDER = (
    "target",
    "looks",
    "source",
    "state_predictor",
    "source_teacher",
    "source_student",
    "source_policy",
    "direct_transfer",
    "visual",
    "translated",
    "estimator",
    "control",
    "effects",
    "dynamics",
    "selection",
    "teacher",
    "student",
    "policy",
    "evaluation",
)
"""Stages of a grounding step."""


MEASURED = ("evaluation", "effects", "selection", "looks", "policy/stage")
"""What is read of a grounding step, in the order of :class:`StepRecord`'s fields."""


@dataclass(frozen=True)
class StepRecord:
    """One grounding step. What has not been measured (yet) is empty.

    Attributes:
        k: its number.
        folder: ``RUN/step_<k>``.
        evaluation: returns, residuals and translation errors, as in ``evaluation.json``.
        effects: what was found missing in the source, as in ``effects.json``.
        selection: whether F was kept, as in ``selection.json``.
        looks: visual effects that were found missing in the source, as in ``looks.json``.
        training: of the policy, as in its ``stage.json``: whether it was put back to what it was before.
        seconds: wall-clock time of every finished stage, s, in the order of Algorithm 1.
        interactions: target control steps that training had used when this step's policy was made.
    """

    k: int
    folder: Path
    evaluation: dict
    effects: dict
    selection: dict
    looks: dict
    training: dict
    seconds: dict[str, float]
    interactions: int


@dataclass(frozen=True)
class RunRecord:
    """A run.

    Attributes:
        run: its folder.
        config: as in ``config.yaml``.
        provenance: as in ``run.json``.
        ledger: entries of ``ledger.json``.
        direct_transfer: the source policy in the target.
        oracle: the reference that trained in the target; empty if there is none.
        steps: those that have begun.
        unreadable: files that are there but make no sense.
    """

    run: Path
    config: dict
    provenance: dict
    ledger: list[dict]
    direct_transfer: dict
    oracle: dict
    steps: list[StepRecord]
    unreadable: list[str] = field(default_factory=list)

    @property
    def planned(self) -> int:
        """Grounding steps that the config asks for."""
        return self.config["schedule"]["grounding_steps"]

    @property
    def evaluated(self) -> list[StepRecord]:
        """Steps that went to their end."""
        return [s for s in self.steps if s.evaluation]

    @property
    def finished(self) -> bool:
        """Whether every step went to its end."""
        return len(self.evaluated) == self.planned + 1


def read_run_record(run: Path) -> RunRecord:
    """Read a run folder.

    Raises:
        ValueError: if it has no config.
    """
    if not (run / "config.yaml").is_file():
        raise ValueError(f"{run} is not a run folder: it has no config.yaml. Give the folder that `idapt fit` wrote.")
    unreadable: list[str] = []

    def read(path: Path) -> dict:
        try:
            return json.loads(path.read_text())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            unreadable.append(str(path.relative_to(run)))
            return {}

    ledger = read(run / "ledger.json").get("entries", [])
    first = run / "step_00"
    return RunRecord(
        run,
        yaml.safe_load((run / "config.yaml").read_text()),
        read(run / "run.json"),
        ledger,
        read(first / "direct_transfer.json"),
        read(first / "oracle_evaluation.json"),
        [read_step_record(folder, ledger, read) for folder in sorted(run.glob("step_[0-9]*"))],
        unreadable,
    )


def read_step_record(folder: Path, ledger: list[dict], read) -> StepRecord:
    """Read the folder of one grounding step."""
    k = int(folder.name.removeprefix("step_"))
    used = sum(e["count"] for e in ledger if e["purpose"] == "training" and e["step"] <= k)
    measured = [read(folder / f"{name}.json") for name in MEASURED]
    found = map(read, sorted([*folder.glob("*/stage.json"), *folder.glob("*.json")]))
    seconds = {t["stage"]: t["wall_s"] for t in found if {"stage", "wall_s"} <= set(t)}
    return StepRecord(k, folder, *measured, {name: seconds[name] for name in sorted(seconds, key=place)}, used)


def place(stage: str) -> int:
    """Where a stage stands in Algorithm 1; what is not of it (the oracle) comes last."""
    return ORDER.index(stage) if stage in ORDER else len(ORDER)

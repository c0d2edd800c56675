"""What a run folder says, finished or not: everything may be missing but the config."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from idapt_pl.appearance import VisualEffects
from idapt_pl.envs.ledger import Ledger
from idapt_pl.files import read_json
from idapt_pl.image_diagnosis import ImageDiagnosis
from idapt_pl.run_folder.kept_config import read_kept_config
from idapt_pl.run_folder.kept_warnings import WARNINGS, read_warnings
from idapt_pl.run_folder.results import UNCUT, belongs

ORDER = (
    "target",
    "looks",
    "source",
    "moved",
    "replayed",
    "state_predictor",
    "source_teacher",
    "source_teacher_success",
    "source_student",
    "source_start",
    "source_rehearsal_teacher",
    "source_estimator_teacher",
    "source_filter_teacher",
    "source_rehearsal_policy",
    "source_estimator_policy",
    "source_filter_policy",
    "source_policy",
    "direct_transfer",
    "convergence",
    "visual",
    "translated",
    "moved_translated",
    "estimator",
    "control",
    "effects",
    "known_start_search",
    "repaired_source",
    "repaired_replayed",
    "repaired_visual",
    "repaired_translated",
    "repaired_moved_translated",
    "repaired_estimator",
    "dynamics",
    "selection",
    "reading_offsets",
    "reading_errors",
    "lost",
    "labelled",
    "cut",
    "replay_labelled",
    "replay_agreement",
    "estimator_replayed",
    "teacher",
    "teacher_trials",
    "student",
    "rehearsal_teacher",
    "estimator_teacher",
    "filter_teacher",
    "rehearsal_policy",
    "estimator_policy",
    "filter_policy",
    "trial_rehearsal",
    "hardened_teacher",
    "hardened_rehearsal_teacher",
    "hardened_estimator_teacher",
    "hardened_filter_teacher",
    "hardened_rehearsal_policy",
    "hardened_estimator_policy",
    "hardened_filter_policy",
    "policy",
    "evaluation",
)
"""Stages of a grounding step."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class StepRecord:
    """One grounding step. What has not been measured (yet) is empty.

    Attributes:
        k: its number.
        folder: ``RUN/step_<k>``.
        evaluation: returns, residuals and translation errors, as in ``evaluation.json``.
        diagnosis: what the source was found to lack (``effects.json``); None if nothing was looked for.
        searched: what forecasts from known starts made of every candidate, as in ``known_start_search.json``.
        selection: whether F was kept, as in ``selection.json``.
        labels: how wrong readings of the target are taken to be, as in ``reading_errors.json``.
        convergence: whether anything was left to learn, as in ``convergence.json``.
        visual_effects: what its pictures were found to lack (``looks.json``); likewise.
        training: of the policy, as in its ``stage.json``: whether it was put back to what it was before.
        seconds: wall-clock time of every finished stage, s, in the order of Algorithm 1.
        interactions: target control steps that training had used when this step's policy was made.
        ran_away: stages whose losses ran away though they stayed finite, each in words.
    """

    k: int
    folder: Path
    evaluation: dict
    diagnosis: ImageDiagnosis | None
    searched: dict
    selection: dict
    labels: dict
    convergence: dict
    visual_effects: VisualEffects | None
    training: dict
    seconds: dict[str, float]
    interactions: int
    ran_away: list[str] = field(default_factory=list)

    @property
    def settled(self) -> bool:
        """Whether the run ended with it, since there was nothing left to learn."""
        return bool(self.convergence.get("settled", False))

    @property
    def source_repaired(self) -> bool:
        """Whether effects were added to the source in it."""
        physical = self.searched["effects"] if self.searched else self.diagnosis and self.diagnosis.effects
        return bool(physical or (self.visual_effects and self.visual_effects.effects))


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
        warnings: what the run warned of.
        unreadable: files that are there but make no sense.
    """

    run: Path
    config: dict
    provenance: dict
    ledger: list[dict]
    direct_transfer: dict
    oracle: dict
    steps: list[StepRecord]
    warnings: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)

    @property
    def planned(self) -> int:
        """Grounding steps that the config asks for."""
        return self.config["schedule"]["grounding_steps"]

    @property
    def method(self) -> str:
        """What was run."""
        return self.config.get("method", "idapt")

    @property
    def stepless(self) -> bool:
        """Whether it is of a policy alone, without grounding steps."""
        return self.method in ("source", "oracle")

    @property
    def reference(self) -> dict:
        """What its policy reached, of a run without grounding steps."""
        return {"source": self.direct_transfer, "oracle": self.oracle}.get(self.method, {})

    @property
    def evaluated(self) -> list[StepRecord]:
        """Steps that went to their end."""
        return [s for s in self.steps if s.evaluation]

    @property
    def finished(self) -> bool:
        """Whether every step went to its end, or one showed that there was nothing left to learn."""
        if self.stepless:
            return (self.run / "summary.json").exists()
        return len(self.evaluated) == self.planned + 1 or any(s.settled for s in self.steps)


class RunFiles:
    """Reads JSON files of a run folder, and remembers those that make no sense.

    Args:
        run: the folder.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self.unreadable: list[str] = []

    def read(self, path: Path, keys: Collection[str] = ()) -> dict:
        """The content of a file; empty if it is missing or unreadable, lacks keys, or is of something else."""
        if not path.exists():
            return {}
        try:
            entry = read_json(path, keys)
        except ValueError:
            self._note_unreadable(path)
            return {}
        if not belongs(path, entry):
            self._note_unreadable(path)
            return {}
        return entry

    def read_as(self, path: Path, from_dict: Callable[[Mapping], Result]) -> Result | None:
        """The value that a file holds; None if it is missing or unreadable."""
        if not (entry := self.read(path)):
            return None
        try:
            return from_dict(entry)
        except Exception:  # what damaged data do to a constructor can be anything
            self._note_unreadable(path)
            return None

    def _note_unreadable(self, path: Path) -> None:
        name = str(path.relative_to(self.run))
        if name not in self.unreadable:
            self.unreadable.append(name)


def read_run_record(run: Path) -> RunRecord:
    """Read a run folder.

    Raises:
        ValueError: if it has no config.
    """
    config = read_kept_config(run)
    if config is None:
        raise ValueError(f"{run} is not a run folder: it has no config.yaml. Give the folder that `idapt fit` wrote.")
    files, first = RunFiles(run), run / "step_00"
    ledger = files.read_as(run / "ledger.json", lambda _: Ledger(run / "ledger.json").entries) or []
    return RunRecord(
        run,
        config,
        files.read(run / "run.json"),
        ledger,
        direct if "mean" in (direct := files.read(first / "direct_transfer.json", ("interactions",))) else {},
        files.read(first / "oracle_evaluation.json", ("mean", "std")),
        [read_step_record(folder, ledger, files) for folder in sorted(run.glob("step_[0-9]*"))],
        files.read_as(run / WARNINGS, lambda _: read_warnings(run)) or [],
        files.unreadable,
    )


def read_step_record(folder: Path, ledger: list[dict], files: RunFiles) -> StepRecord:
    """Read the folder of one grounding step."""
    k = int(folder.name.removeprefix("step_"))
    timed = list(map(files.read, sorted([*folder.glob("*/stage.json"), *folder.glob("*.json")])))
    seconds = {t["stage"]: t["wall_s"] for t in timed if {"stage", "wall_s"} <= set(t)}
    return StepRecord(
        k,
        folder,
        evaluation=files.read(folder / "evaluation.json", ("target", "grounded", "translation")),
        diagnosis=files.read_as(folder / "effects.json", ImageDiagnosis.from_dict),
        searched=files.read(folder / "known_start_search.json", ("effects", "parameters")),
        selection=files.read(folder / "selection.json"),
        labels=files.read(folder / "reading_errors.json"),
        convergence=files.read(folder / "convergence.json"),
        visual_effects=files.read_as(folder / "looks.json", VisualEffects.from_dict),
        training=files.read(folder / "policy/stage.json"),
        seconds={name: seconds[name] for name in sorted(seconds, key=stage_place)},
        interactions=sum(e["count"] for e in ledger if e["purpose"] == "training" and e["step"] <= k),
        ran_away=[f"{t['stage']}: {words}" for t in timed for words in t.get("ran_away", [])],
    )


def stage_place(stage: str) -> tuple[int, int, int]:
    """Where a stage stands in Algorithm 1, for sorting; what is not of it (the oracle) comes last."""
    uncut, whole = stage.startswith(UNCUT), stage.removeprefix(UNCUT).removesuffix("_cut")
    if whole != stage:  # before exploring episodes were cut, or the cutting
        return stage_place(whole)[0], -1 if uncut else 0, 1
    name = re.sub(r"_\d+$", "", stage)
    number = int(stage[len(name) + 1 :] or 1)  # one of several candidates, or rounds
    place = ORDER.index(name) if name in ORDER else len(ORDER)
    if number > 1 and (rehearsed := re.fullmatch(r"(.*?)(rehearsal|estimator|filter)_policy", name)):
        return ORDER.index(f"{rehearsed[1]}filter_policy"), number, place  # a round begins after all of the one before
    return place, 0, number

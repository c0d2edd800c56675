"""The folder of a sweep: what is planned, how far each run is, and where its files are."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from idapt_pl.files import DamagedFile, read_json, read_yaml, write_bytes, write_json, write_yaml
from idapt_pl.run_folder.kept_config import read_kept_config

if TYPE_CHECKING:
    from idapt_pl.sweep.plan import PlannedRun

WAITING, RUNNING, DONE, FAILED, BY_HAND = "waiting", "running", "done", "failed", "waits for recordings"
"""States of a run. One that was stopped waits again."""


@dataclass(frozen=True)
class RunStatus:
    """How far a run is.

    Attributes:
        state: one of the states above.
        failures: of its attempts that failed: exit code, host and last lines.
        host: where it is, or was last.
    """

    state: str = WAITING
    failures: list[dict[str, Any]] = field(default_factory=list)
    host: str = ""


@dataclass(frozen=True)
class SweepFolder:
    """Where things are in the folder of a sweep.

    Attributes:
        path: the folder.
    """

    path: Path

    @property
    def yaml(self) -> Path:
        """The sweep's YAML, as it was last run."""
        return self.path / "sweep.yaml"

    @property
    def plan(self) -> Path:
        """The runs, in order."""
        return self.path / "plan.json"

    def config(self, name: str) -> Path:
        """The complete config of a run."""
        return self.path / "configs" / f"{name}.yaml"

    def run(self, name: str) -> Path:
        """The run folder of a run."""
        return self.path / "runs" / name

    def log(self, name: str) -> Path:
        """What a run said, attempt after attempt."""
        return self.path / "logs" / f"{name}.log"

    def status_file(self, name: str) -> Path:
        """How far a run is."""
        return self.path / "status" / f"{name}.json"

    def read_plan(self) -> list[PlannedRun]:
        """The runs as they were planned last; none if there is no plan yet.

        Raises:
            DamagedFile: if the plan cannot be read.
        """
        from idapt_pl.sweep.plan import PlannedRun

        if not self.plan.exists():
            return []
        cure = "Delete it, and the same `idapt sweep --config` makes it again."
        told = read_json(self.plan, ("runs",), cure)
        try:
            return [PlannedRun(**run) for run in told["runs"]]
        except TypeError as error:
            raise DamagedFile(f"{self.plan}: cannot be used ({error}). {cure}") from None

    def write_plan(self, runs: Sequence[PlannedRun]) -> None:
        """Keep the runs."""
        write_json(self.plan, {"runs": [run.to_dict() for run in runs]})

    def write_config(self, name: str, config: dict[str, Any]) -> None:
        """Keep the complete config of a run."""
        write_yaml(self.config(name), config)

    def begun_config(self, name: str) -> dict[str, Any] | None:
        """The config that a run was begun with; None if it was not."""
        kept = read_kept_config(self.run(name)) if self.run(name).is_dir() else None
        return kept if kept is None else json.loads(json.dumps(kept))

    def config_of(self, name: str) -> dict[str, Any]:
        """The complete config of a run that was planned."""
        return read_yaml(self.config(name)) or {}

    def forget_failures(self, name: str) -> None:
        """Let a run that failed be tried again."""
        if (status := self.status(name)).failures and status.state != RUNNING:
            self.write_status(name, RunStatus(WAITING if status.state == FAILED else status.state, [], status.host))

    def status(self, name: str) -> RunStatus:
        """How far a run is. One that says that it is running but whose process is gone waits.

        Raises:
            DamagedFile: if it cannot be read.
        """
        path = self.status_file(name)
        cure = "Delete it: then failures before are forgotten, and the run goes on."
        told = read_json(path, ("state", "failures", "host"), cure) if path.exists() else {}
        status = RunStatus(**told)
        if status.state == RUNNING and not self.at_work(name):
            return RunStatus(WAITING, status.failures, status.host)
        if status.state == DONE and not (self.run(name) / "summary.json").exists():
            return RunStatus(WAITING, status.failures, status.host)
        return status

    def write_status(self, name: str, status: RunStatus) -> None:
        """Keep how far a run is."""
        write_json(self.status_file(name), asdict(status))

    def lock(self, name: str) -> FileLock:
        """What the one process holds that has a run in work."""
        path = self.path / "status" / f".{name}.lock"
        path.parent.mkdir(parents=True, exist_ok=True)
        return FileLock(path)

    def at_work(self, name: str) -> bool:
        """Whether a process has a run in work, here or on another machine with the same file system."""
        if not os.path.exists(self.path / "status" / f".{name}.lock"):
            return False
        try:
            with self.lock(name).acquire(blocking=False):
                return False
        except Timeout:
            return True

    def keep_yaml(self, path: Path) -> None:
        """Keep a copy of the sweep's YAML."""
        text = path.read_bytes()
        if path.resolve() != self.yaml.resolve() and not (self.yaml.exists() and self.yaml.read_bytes() == text):
            write_bytes(self.yaml, text)


def last_stage(run: Path) -> str:
    """What a run finished last, such as ``step 0 visual``; empty if nothing yet."""
    found = [p for p in run.glob("step_[0-9]*/*/stage.json")] + [p for p in run.glob("step_[0-9]*/*.json")]
    if not found:
        return ""
    newest = max(found, key=lambda p: p.stat().st_mtime)
    stage = newest.parent if newest.name == "stage.json" else newest.with_suffix("")
    return f"step {int(stage.parent.name.removeprefix('step_'))} {stage.name.replace('_', ' ')}"

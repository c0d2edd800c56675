"""One run of a sweep, from where it stands to its end: what local processes, Ray tasks and array jobs all call."""

from __future__ import annotations

import signal
import socket
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from filelock import Timeout

from idapt_pl.sweep.child import FIT, Attempt
from idapt_pl.sweep.folder import BY_HAND, DONE, FAILED, RUNNING, WAITING, RunStatus, SweepFolder
from idapt_pl.sweep.settings import RunResources

LOOK = 0.5
"""Seconds between looks at a run."""

PATIENCE = 2.0
"""Seconds after which a run that another process holds is left to it; one that only looks holds it for a moment."""

BAD_USAGE, NEEDS_RECORDINGS = 2, 3
"""Exit codes of ``idapt fit`` at which trying again helps nothing."""

STOPPED = {sign * (number + plus) for number in (signal.SIGINT, signal.SIGTERM) for sign, plus in ((1, 128), (-1, 0))}
"""Exit codes of a run that somebody stopped, such as a scheduler that signals all processes of a job."""


@dataclass(frozen=True)
class SweepWorker:
    """Carries out runs of a sweep.

    Attributes:
        folder: of the sweep.
        resources: what each run has for itself.
        retries: how often a failure is tried again, those of earlier calls included.
        stopped: asked every now and then; whether to end what is running.
        watch: called with the run folder every now and then, and when an attempt has ended.
        program: module and arguments in place of ``idapt fit``.
        cwd: folder that relative paths in configs are of, if this machine has it; else that of this process.
    """

    folder: SweepFolder
    resources: RunResources
    retries: int
    stopped: Callable[[], bool] = lambda: False
    watch: Callable[[Path], None] = lambda run: None
    program: tuple[str, ...] = FIT
    cwd: str | None = None

    def carry_out(self, name: str, devices: str | None = None) -> RunStatus:
        """Run ``idapt fit`` until it is done, has failed too often, or is to stop.

        Args:
            name: of the run.
            devices: of CUDA; None to leave what is set.

        Returns:
            How far it is, as it is kept too. Of a run that another process has in work, that it is running.
        """
        try:
            with self.folder.lock(name).acquire(timeout=PATIENCE):
                status = self.folder.status(name)
                status = replace(status, state=standing(status, self.retries))
                go_on = True
                while status.state == WAITING and go_on and not self.stopped():
                    status = replace(status, state=RUNNING, host=socket.gethostname())
                    self.folder.write_status(name, status)
                    status, go_on = self.one_attempt(name, status, devices)
                    self.folder.write_status(name, status)
                return status
        except Timeout:
            return RunStatus(RUNNING, host="another process")

    def one_attempt(self, name: str, status: RunStatus, devices: str | None) -> tuple[RunStatus, bool]:
        """Start it and wait. Returns the status after it, and whether to try again if it waits."""
        folder, run, began = self.folder, self.folder.run(name), datetime.now(UTC)
        options = alone(folder.config_of(name), self.resources)
        command = [*self.program, f"--config={folder.config(name)}", f"--run_dir={run}", *options]
        try:
            with Attempt(command, folder.log(name), self.resources.cpus, devices, self.cwd) as attempt:
                while attempt.process.poll() is None and not self.stopped():
                    try:
                        attempt.process.wait(LOOK)
                    except subprocess.TimeoutExpired:
                        self.watch(run)
                code, lines = attempt.process.poll(), attempt.last_lines()
        except BaseException:  # whoever ends this process: the run is no failure
            folder.write_status(name, replace(status, state=WAITING))
            raise
        self.watch(run)
        if code is None or code in STOPPED:
            return replace(status, state=WAITING), False
        if code == 0:
            return replace(status, state=DONE), False
        if code == NEEDS_RECORDINGS:
            return replace(status, state=BY_HAND), False
        seconds = round((datetime.now(UTC) - began).total_seconds())
        failure = {"code": code, "host": status.host, "began": began.isoformat(timespec="seconds"), "seconds": seconds}
        status = replace(status, failures=[*status.failures, failure | {"lines": lines}])
        return replace(status, state=standing(replace(status, state=FAILED), self.retries)), True


def standing(status: RunStatus, retries: int) -> str:
    """The state of a run that nobody has in work: done, failed for good, or to be run."""
    if status.state == DONE:
        return DONE
    hopeless = any(failure["code"] == BAD_USAGE for failure in status.failures)
    return FAILED if hopeless or len(status.failures) > retries else WAITING


def alone(config: dict[str, Any], resources: RunResources) -> list[str]:
    """Arguments that keep a run to its cores, where its config leaves them open."""
    wanted = {"threads": resources.cpus, "side_by_side": "false", "render_processes": resources.cpus - 1}
    return [f"--{key}={value}" for key, value in wanted.items() if config.get(key) is None]

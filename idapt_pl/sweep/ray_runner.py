"""Runs of a sweep on a Ray cluster: each a task with its cores and cards; those of a lost machine go on elsewhere."""

from __future__ import annotations

import hashlib
import logging
import os
import socket
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from filelock import Timeout

from idapt_pl.sweep.child import GRACE
from idapt_pl.sweep.folder import DONE, FAILED, RUNNING, WAITING, RunStatus, SweepFolder, last_stage
from idapt_pl.sweep.nodes import check_nodes, look_at_nodes, reachable
from idapt_pl.sweep.runner import TICK
from idapt_pl.sweep.storage import RunStorage, parts_of
from idapt_pl.sweep.work import PATIENCE, SweepWorker
from idapt_pl.usable_cores import usable_cores

LOSSES = 10
"""How often the machine of a run may be lost before the run counts as failed."""

AGAIN = 10.0
"""Seconds until a run is tried again that somebody else had in work; a lost machine's lock may outlive it."""


@dataclass(frozen=True)
class RunTask:
    """What a task is told: where the sweep is, and how to carry out a run.

    Attributes:
        folder: of the sweep, on a shared file system; with ``storage``, on the machine that started the sweep.
        storage: address of the storage, or None.
        worker: carries out the run.
    """

    folder: str
    storage: str | None
    worker: SweepWorker


def carry_out_task(task: RunTask, name: str) -> dict[str, Any]:
    """What a Ray worker does. Returns the run's status."""
    devices = None if task.worker.resources.gpus else ""  # Ray sets those that it gives
    if task.storage is None:
        return asdict(task.worker.carry_out(name, devices))
    return asdict(carry_out_in_a_copy(RunStorage(task.storage), scratch_of(task.storage), task.worker, name, devices))


def scratch_of(storage: str) -> SweepFolder:
    """Where runs of a storage are worked on, on this machine."""
    which = hashlib.sha256(storage.encode()).hexdigest()[:12]
    return SweepFolder(Path(tempfile.gettempdir()) / f"idapt_sweep_{os.getuid()}" / which)


def carry_out_in_a_copy(
    storage: RunStorage, folder: SweepFolder, worker: SweepWorker, name: str, devices: str | None
) -> RunStatus:
    """Fetch a run, carry it out, and copy it back after each stage.

    Args:
        storage: where it is kept.
        folder: where it is worked on.
        worker: carries it out.
        name: of the run.
        devices: of CUDA.
    """
    copied: str | None = None

    def copy_after_a_stage(run: Path) -> None:
        nonlocal copied
        if (stage := last_stage(run)) != copied:
            storage.put(folder.path, parts_of(name))
            copied = stage

    try:
        with folder.lock(f"{name}.copy").acquire(timeout=PATIENCE):
            storage.get(folder.path, (f"configs/{name}.yaml", *parts_of(name)))
            status = replace(worker, folder=folder, watch=copy_after_a_stage).carry_out(name, devices)
            storage.put(folder.path, parts_of(name))
            return status
    except Timeout:  # its predecessor on this machine has not left yet
        return RunStatus(RUNNING, host="another process")


class RayRunner:
    """Carries out runs as Ray tasks.

    Args:
        worker: carries out one run.
        address: ``auto``, ``local``, ``HOST:PORT`` or ``ray://HOST:PORT``.
        storage: where runs are kept between stages if machines share no file system.

    Raises:
        ValueError: if Ray is not installed, there is no cluster, or a machine of it cannot carry out runs.
    """

    def __init__(self, worker: SweepWorker, address: str, storage: str | None = None) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise ValueError("--address needs Ray, which is not installed: pip install 'idapt[ray]'") from None
        self.ray, self.storage = ray, None if storage is None else RunStorage(storage)
        self.worker, self._refs, self._fetched_at = worker, dict[Any, str](), 0.0
        self._task = RunTask(str(worker.folder.path.resolve()), storage, worker_of(worker))
        connect(ray, address)
        seen = look_at_nodes(ray, None if storage else Path(self._task.folder))
        self.side_by_side = check_nodes(seen, worker.resources, self._task.folder)
        options = {"num_cpus": worker.resources.cpus, "num_gpus": worker.resources.gpus, "max_retries": 0}
        self._remote = ray.remote(carry_out_task).options(**options, scheduling_strategy="SPREAD")

    def run(self, names: Sequence[str], tick: Callable[[], None]) -> None:
        """Carry out runs; returns when each is done, has failed or waits for recordings.

        Args:
            names: of the runs, in order.
            tick: called every second.
        """
        with ExitStack() as held:
            if self.storage is not None:
                self._send(names, held)
            told, losses, later = self.ray.put(self._task), dict.fromkeys(names, 0), list[tuple[float, str]]()
            self._refs = {self._remote.remote(told, name): name for name in names}
            while self._refs or later:
                for ref in self._ready():
                    name = self._refs.pop(ref)
                    again = self._ended(ref, name, losses)
                    if again is not None:
                        later.append((time.monotonic() + again, name))
                due = [name for when, name in later if when <= time.monotonic()]
                later = [(when, name) for when, name in later if name not in due]
                self._refs |= {self._remote.remote(told, name): name for name in due}
                self._fetch_statuses()
                tick()

    def stop(self) -> None:
        """End what is running, and wait until it has ended."""
        for ref in self._refs:
            self.ray.cancel(ref, force=False)
        if self._refs:
            self.ray.wait(list(self._refs), num_returns=len(self._refs), timeout=GRACE + 5)
        if self.storage is not None:
            for name in self._refs.values():
                self.storage.get(self.worker.folder.path, parts_of(name))
        self.ray.shutdown()

    def _ready(self) -> list[Any]:
        """Tasks that have ended, after a second at the latest."""
        if not self._refs:
            time.sleep(TICK)
            return []
        return self.ray.wait(list(self._refs), timeout=TICK)[0]

    def _fetch_statuses(self) -> None:
        """Learn from the storage what is running, now and then."""
        if self.storage is not None and time.monotonic() > self._fetched_at + AGAIN:
            self.storage.get(self.worker.folder.path, [f"status/{name}.json" for name in self._refs.values()])
            self._fetched_at = time.monotonic()

    def _ended(self, ref: Any, name: str, losses: dict[str, int]) -> float | None:
        """What became of a task: seconds until the run is to be tried again, or None if it is not."""
        folder, status = self.worker.folder, None
        try:
            status = RunStatus(**self.ray.get(ref))
        except self.ray.exceptions.TaskCancelledError:
            return None
        except self.ray.exceptions.RayTaskError as error:  # ours, such as a full disk there
            lines = [str(error.cause)]
        except self.ray.exceptions.RayError as error:  # the machine or its worker is gone
            losses[name] += 1
            if losses[name] <= LOSSES:
                return 0.0
            lines = [f"its machine was lost {losses[name]} times, last: {str(error).splitlines()[0]}"]
        if self.storage is not None:
            self.storage.get(folder.path, parts_of(name))
        if status is None:
            before = folder.status(name)
            failure = {"code": 1, "host": before.host or socket.gethostname(), "lines": lines}
            status = RunStatus(WAITING, [*before.failures, failure], before.host)
            given_up = losses[name] > LOSSES or len(status.failures) > self.worker.retries
            status = replace(status, state=FAILED if given_up else WAITING)
            folder.write_status(name, status)
            return None if given_up else AGAIN
        return AGAIN if status.state == RUNNING else 0.0 if status.state == WAITING else None

    def _send(self, names: Sequence[str], held: ExitStack) -> None:
        """Bring configs, and what was done here before, to the storage; the runs are this process's from now on."""
        assert self.storage is not None
        folder = self.worker.folder
        for name in names:
            try:
                held.enter_context(folder.lock(name).acquire(timeout=PATIENCE))
            except Timeout:
                raise ValueError(f"another process has {name} in work; wait until it has ended") from None
            self.storage.put(folder.path, [f"configs/{name}.yaml"])
            status = folder.status(name)
            if self.storage.has(f"runs/{name}"):  # an earlier call's: newer than what is here
                self.storage.get(folder.path, parts_of(name))
            elif status.state != DONE:
                self.storage.put(folder.path, parts_of(name))


def worker_of(worker: SweepWorker) -> SweepWorker:
    """The worker as a task takes it: with the whole path of its folder, and nothing that asks this process."""
    folder = SweepFolder(worker.folder.path.resolve())
    return SweepWorker(folder, worker.resources, worker.retries, program=worker.program, cwd=os.getcwd())


def connect(ray: Any, address: str) -> None:
    """Join a cluster, or begin one on this machine.

    Raises:
        ValueError: if there is none.
    """
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if address == "local":
            ray.init(address="local", num_cpus=usable_cores(), include_dashboard=False, **quiet)
            return
        reachable(address)
        ray.init(address=address, **quiet)
    except (ConnectionError, OSError, RuntimeError, ValueError, TimeoutError) as error:
        raise ValueError(
            f"--address {address}: no Ray cluster there ({' '.join(str(error).split())[:200]}). Start one with "
            "`ray start --head`, take --address local for one on this machine, or leave --address out"
        ) from None

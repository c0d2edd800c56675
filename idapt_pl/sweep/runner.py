"""Runs of a sweep in processes of this machine, as many side by side as its cores and cards allow."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from idapt_pl.sweep.child import GRACE
from idapt_pl.sweep.settings import RunResources
from idapt_pl.sweep.work import SweepWorker

TICK = 1.0
"""Seconds between looks at all runs."""


def visible_devices() -> list[str]:
    """Graphics cards that this process may use, by what CUDA calls them."""
    import torch

    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    if named is not None:
        return [name for name in named.split(",") if name]
    return [str(i) for i in range(torch.cuda.device_count())]


def local_slots(resources: RunResources, cores: int, devices: Sequence[str]) -> list[str]:
    """The CUDA devices of each run that fits beside the others.

    Raises:
        ValueError: if not even one fits.
    """
    if resources.cpus > cores:
        raise ValueError(f"resources.cpus is {resources.cpus}, but this machine has {cores} to use")
    beside = cores // resources.cpus
    if resources.gpus == 0:
        return [""] * beside
    if resources.gpus > len(devices):
        raise ValueError(f"resources.gpus is {resources.gpus:g}, but this machine has {len(devices)} to use")
    if resources.gpus <= 1:
        each = int(1 / resources.gpus + 1e-9)
        return [device for _ in range(each) for device in devices][:beside]
    count = int(-(-resources.gpus // 1))
    return [",".join(devices[i : i + count]) for i in range(0, len(devices) - count + 1, count)][:beside]


class LocalRunner:
    """Carries out runs in threads that each wait for a process.

    Args:
        worker: carries out one run.
        slots: CUDA devices of each run that may go side by side.
    """

    def __init__(self, worker: SweepWorker, slots: Sequence[str]) -> None:
        self._stopping, self._left = threading.Event(), queue.Queue[str]()
        self.worker = replace(worker, stopped=self._stopping.is_set)
        self.slots, self._threads = slots, list[threading.Thread]()
        self._ended: list[threading.Event] = []
        self._errors: list[BaseException] = []

    def run(self, names: Sequence[str], tick: Callable[[], None]) -> None:
        """Carry out runs; returns when each is done, has failed or waits for recordings.

        Args:
            names: of the runs, in order.
            tick: called every second.
        """
        for name in names:
            self._left.put(name)
        for devices in self.slots[: len(names)]:
            self._ended.append(ended := threading.Event())
            thread = threading.Thread(target=self._work, args=(devices, ended), daemon=True)
            self._threads.append(thread)
            thread.start()
        for thread in self._threads:
            while thread.is_alive():
                thread.join(TICK)
                tick()
        if self._errors:
            raise self._errors[0]

    def stop(self) -> None:
        """End what is running, and wait until it has ended."""
        self._stopping.set()
        for ended in self._ended:  # an exception out of a thread's join makes Python take it for dead
            ended.wait(GRACE + 5)

    def _work(self, devices: str, ended: threading.Event) -> None:
        try:
            self._carry_out_what_is_left(devices)
        finally:
            ended.set()

    def _carry_out_what_is_left(self, devices: str) -> None:
        while not self._stopping.is_set():
            try:
                name = self._left.get_nowait()
            except queue.Empty:
                return
            try:
                self.worker.carry_out(name, devices)
            except (
                BaseException
            ) as error:  # of this machine, such as a full disk: it is told when the others have ended
                self._errors.append(error)
                return

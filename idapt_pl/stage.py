"""One stage: seed, skip if done, fit with a fresh Trainer, keep the result. The only user of Trainer."""

from __future__ import annotations

import hashlib
import logging
import math
import shutil
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import lightning as L
import torch
from lightning.pytorch.loggers import CSVLogger

from datamodules import Trajectories, write_trajectories
from datamodules.trajectories import count_steps
from idapt_pl.checkpoints import checkpoint_bytes, load_weights
from idapt_pl.cores import FreeCores
from idapt_pl.files import blaming, read_json, sha256, verify, write_bytes, write_json
from idapt_pl.health import Health, check_weights
from idapt_pl.memory import tidy_memory
from idapt_pl.run_folder.results import read_result
from idapt_pl.run_folder.time_left import TimeLeft, in_words

log = logging.getLogger(__name__)
Module = TypeVar("Module", bound=L.LightningModule)
TRAIN_AGAIN = "again"
"""Among the notes of a training: it was not enough, and the stage trains once more."""
MakeTrainer = Callable[[Path, int], L.Trainer]
"""Folder of the stage and its number of batches to a fresh Trainer."""


def stage_trainer_settings(folder: Path, batches: int, shows_bars: bool | None = None) -> dict[str, Any]:
    """What every stage's Trainer is told; the rest is the user's. There are bars where a person watches, by default."""
    return {
        "default_root_dir": str(folder),
        "max_epochs": 1,
        "limit_train_batches": batches,
        "log_every_n_steps": max(1, batches // 250),
        "enable_progress_bar": sys.stderr.isatty() if shows_bars is None else shows_bars,
        "enable_checkpointing": False,
        "enable_model_summary": False,
    }


def cpu_trainer(folder: Path, batches: int) -> L.Trainer:
    """A Trainer for small nets, outside a run of Algorithm 1: on the CPU, metrics to a CSV file."""
    logger = CSVLogger(folder, name="", version="")
    return L.Trainer(accelerator="cpu", logger=logger, **stage_trainer_settings(folder, batches))


def stage_seed(seed: int, step: int, name: str) -> int:
    """A seed of its own for every stage, so that none depends on what ran before it."""
    return zlib.crc32(f"{seed}/{step}/{name}".encode()) % 2**31


def load_finished(module: Module, checkpoint: Path) -> Module:
    """A module with the weights that its stage ended with, ready for use (weights only, nothing is unpickled).

    Raises:
        DamagedFile: if they are not as the stage wrote them, or of another module.
    """
    load_weights(module, checkpoint)
    return module.eval()


class Stages:
    """Runs stages inside a run folder, ``RUN/step_<k>/<name>/``; a stage that is done is loaded instead.

    Args:
        run_dir: the run folder.
        seed: the run's seed; each stage derives its own.
        make_trainer: a fresh Trainer, since a Trainer's counters survive a fit.
        threads: that a stage computes with; None for as many as there are free cores.

    Attributes:
        time_left: is told of every stage, so that the log says how long the rest takes; None says nothing.
    """

    time_left: TimeLeft | None = None

    def __init__(self, run_dir: Path, seed: int, make_trainer: MakeTrainer, threads: int | None = None) -> None:
        self.run_dir, self.seed, self.make_trainer, self.cores = run_dir, seed, make_trainer, FreeCores(threads)

    def folder(self, step: int) -> Path:
        """Folder of one grounding step."""
        return self.run_dir / f"step_{step:02d}"

    def fit(
        self,
        step: int,
        name: str,
        build: Callable[[], Module],
        feed: Callable[[Module, int, torch.device], L.LightningDataModule],
        batches: int,
        finish: Callable[[Module, torch.device, int], dict] = lambda module, device, attempt: {},
    ) -> Module:
        """Fit a module, or load it if this stage is done.

        Args:
            step: grounding step.
            name: of the stage.
            build: makes the module (randomness is seeded before).
            feed: makes its data from the module, the stage's seed and the device trained on.
            batches: how long to fit.
            finish: given the fitted module on its device, and how often it was fitted, may change it before it is kept;
                what it returns is noted in ``stage.json``. With ``TRAIN_AGAIN`` in it the module is fitted once more.

        Raises:
            DamagedFile: if this stage is done and its checkpoint cannot be used.
            NotFinite: if a loss or a weight is NaN or infinite; nothing is kept.
        """
        folder, seed = self.folder(step) / name, stage_seed(self.seed, step, name)
        L.seed_everything(seed, verbose=False)
        module = build()
        final = folder / "final.ckpt"
        if final.exists():
            log.info("step %d  %-16s done before, loaded from %s", step, name, final)
            self._left(step, name, None)
            return load_finished(module, final)
        tidy_memory()
        shutil.rmtree(folder, ignore_errors=True)  # what a killed attempt left
        started, notes, attempt = time.perf_counter(), {TRAIN_AGAIN: batches > 0}, 0
        health = Health(f"step {step}, stage {name}")
        while notes.pop(TRAIN_AGAIN, False):
            health = Health(health.where) if attempt else health  # early and late are those of one attempt
            logs = folder / f"again_{attempt + 1}" if attempt else folder  # curves that begin anew are not mixed
            trainer = self.make_trainer(logs, batches)
            trainer.callbacks += [self.cores, health]
            device = trainer.strategy.root_device
            data = feed(module.to(device), seed + attempt, device)
            with health.explaining(module):
                trainer.fit(module, datamodule=data)
            away, attempt = health.running_away(module, data), attempt + 1
            notes = finish(module.to(device), device, attempt) | ({"ran_away": away} if away else {})
        check_weights(module, health.where, health.cure(module))
        seconds = time.perf_counter() - started
        weights = checkpoint_bytes(module)
        about = {"step": step, "stage": name, "wall_s": round(seconds, 2), "batches": batches}
        about["sha256"] = hashlib.sha256(weights).hexdigest()
        write_json(folder / "stage.json", about | notes, checked=True)
        write_bytes(final, weights)
        left = self._left(step, name, seconds)
        log.info("step %d  %-16s %5d batches  %6.1f s  -> %s%s", step, name, batches, seconds, final, left)
        return module.cpu().eval()

    def record(self, step: int, name: str, make: Callable[[int], Trajectories]) -> tuple[Path, int]:
        """Collect a trajectory file, or keep the one that is there. Returns its path and its control steps.

        Raises:
            DamagedFile: if the one that is there is not as it was written.
        """
        path = self.folder(step) / f"{name}.h5"
        if not path.exists():
            started = time.perf_counter()
            tidy_memory()
            self.cores.look()
            seed = stage_seed(self.seed, step, name)
            L.seed_everything(seed, verbose=False)  # stochastic policies draw from torch's generator
            write_trajectories(path, make(seed))
            seconds = time.perf_counter() - started
            about = {"step": step, "stage": name, "wall_s": round(seconds, 2), "sha256": sha256(path)}
            write_json(path.with_suffix(".json"), about, checked=True)
            log.info("step %d  %-16s %6.1f s  -> %s%s", step, name, seconds, path, self._left(step, name, seconds))
        else:
            verify(path)
            self._left(step, name, None)
        with blaming(path):
            return path, count_steps(path)

    def measure(self, step: int, name: str, make: Callable[[int], dict]) -> dict:
        """Compute a JSON result, or read the one that is there.

        Raises:
            DamagedFile: if the one that is there is damaged, or that of something else.
        """
        path = self.folder(step) / f"{name}.json"
        if not path.exists():
            started = time.perf_counter()
            tidy_memory()
            self.cores.look()
            seed = stage_seed(self.seed, step, name)
            L.seed_everything(seed, verbose=False)
            result = make(seed)
            seconds = time.perf_counter() - started
            timing = {"step": step, "stage": name, "wall_s": round(seconds, 2)}
            write_json(path, timing | result, checked=True)
            log.info("step %d  %-16s %6.1f s  -> %s%s", step, name, seconds, path, self._left(step, name, seconds))
        else:
            self._left(step, name, None)
        return self.read(step, name)

    def _left(self, step: int, name: str, seconds: float | None) -> str:
        """How long the rest of the run takes, after a stage; nothing if it was done before."""
        if self.time_left is None:
            return ""
        left = self.time_left.done(step, name, seconds)
        return f"  (about {in_words(left)} left)" if seconds is not None and left > 0 else ""

    def read(self, step: int, name: str) -> dict:
        """The JSON result of something that was measured.

        Raises:
            DamagedFile: if it is damaged, or that of something else.
        """
        return read_result(self.folder(step) / f"{name}.json")

    def notes(self, step: int, name: str) -> dict:
        """What a finished stage of a module noted, as in its ``stage.json``; empty if there is no such stage.

        Raises:
            DamagedFile: if it is damaged, or that of something else.
        """
        path = self.folder(step) / name / "stage.json"
        return read_result(path) if path.exists() else {}

    def timings(self) -> list[dict]:
        """Step, stage and wall-clock seconds of everything done so far, in order of completion."""
        files = [*self.run_dir.glob("step_*/*/stage.json"), *self.run_dir.glob("step_*/*.json")]
        entries = [read_json(p) for p in sorted(files, key=lambda p: p.stat().st_mtime)]
        told = ("step", "stage", "wall_s")
        return [{k: e[k] for k in told} for e in entries if set(told) <= set(e)]  # others may put files there too

    def elapsed(self) -> float:
        """Seconds in which at least one stage was at work, by when their files were written and how long they took."""
        files = [*self.run_dir.glob("step_*/*/stage.json"), *self.run_dir.glob("step_*/*.json")]
        spans = sorted((p.stat().st_mtime - s, p.stat().st_mtime) for p in files if (s := read_json(p).get("wall_s")))
        seconds, until = 0.0, -math.inf
        for begin, end in spans:
            seconds, until = seconds + max(0.0, end - max(begin, until)), max(end, until)
        return seconds

"""What a run folder says about how it came to be."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import torch
import yaml
from filelock import FileLock, Timeout
from jsonargparse import ArgumentParser, Namespace

from datamodules.atomic import remove_stale
from idapt_pl.files import write_bytes, write_json
from idapt_pl.modules.manual import computes_bfloat16
from idapt_pl.rendering.make import filament_is_used
from idapt_pl.run_folder.kept_config import (
    changed_keys,
    filled,
    goes_further,
    read_kept_config,
    read_run_json,
    without_retired,
)
from idapt_pl.stages.shortened import other_keys

PACKAGES = ("idapt", "torch", "torchvision", "lightning", "mujoco", "dm-control", "gymnasium", "numpy", "h5py")


@contextmanager
def claim(run_dir: Path) -> Iterator[None]:
    """Keep a run folder to this process: two must not write to one. What a killed one left half-written is removed.

    Raises:
        ValueError: if another process is at work in it.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    lock = FileLock(run_dir / ".lock")
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise ValueError(
            f"another process is at work in {run_dir}. Wait until it has ended, or choose another --run_dir."
        ) from None
    try:
        remove_stale(run_dir)
        yield
    finally:
        lock.release()


AT_ONCE = ("config.yaml", "run.json", "ledger.json")
"""What a run folder has before any stage of it."""


def write_provenance(parser: ArgumentParser, config: Namespace, run_dir: Path, divided_by: float = 1.0) -> None:
    """Write ``config.yaml`` (complete, re-runnable) and ``run.json``; a resumed run must have the same config.

    It may have more grounding steps, though.

    ``run.json`` says what the run was started with; every later start is added to its list ``resumed``.

    Args:
        parser: what the config was parsed by.
        config: of the run, its lengths already shortened.
        run_dir: its folder.
        divided_by: what ``--shorten`` divided those lengths by; a folder whose config is the same knows it better.

    Raises:
        ValueError: if the folder holds a run with another config, or a file of it is damaged.
    """
    text = parser.dump(config, skip_none=False)
    path, kept, asked = run_dir / "config.yaml", read_kept_config(run_dir), yaml.safe_load(text)
    # a run that was refused before anything was done may be corrected
    begun = any(p.name not in AT_ONCE and not p.name.startswith(".") for p in run_dir.glob("*"))
    if kept is not None:
        defaults = yaml.safe_load(parser.dump(parser.get_defaults(), skip_none=False, skip_validation=True))
        before = read_run_json(run_dir).get("shortened_by", divided_by)
        old = filled(without_retired(kept), defaults)
        different = [
            k for k in changed_keys(old, asked) if k != "schedule.grounding_steps" or not goes_further(old, asked)
        ]
        if different and begun:
            named = ", ".join(other_keys(different, before, divided_by))
            raise ValueError(
                f"{run_dir} holds a run with another config ({named} differ). "
                f"Choose another --run_dir, or resume with --config {path}."
            )
        divided_by = divided_by if different else before
    first = read_run_json(run_dir) if begun else {}
    write_bytes(path, text.encode())
    now = {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": config.get("seed", config.get("seed_everything")),
        "git_commit": git_commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cpu_threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
        "bfloat16": computes_bfloat16("cuda" if torch.cuda.is_available() else "cpu"),
        "filament": filament_is_used(),
        "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
    }
    told = first | {"resumed": [*first.get("resumed", []), now]} if first else now
    short = {} if divided_by == 1 else {"shortened_by": divided_by}
    write_json(run_dir / "run.json", told | short | {"config": asked}, checked=True)


def git_commit() -> str | None:
    """The commit this code is at, with ``+dirty`` if it was changed since; None outside a checkout.

    Tables in ``results/`` are no code: a benchmark that writes them leaves the commit as it is.
    """
    here = Path(__file__).parent

    def git(*args: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *args], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--", ":/", ":(top,exclude)results")
        return git("rev-parse", "HEAD") + ("+dirty" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def cpu_model() -> str:
    """The processor's name, as far as the system tells, and the vector instructions that torch uses of it."""
    info, name = Path("/proc/cpuinfo"), platform.processor()
    lines = info.read_text().splitlines() if info.exists() else []
    for line in lines:
        if line.startswith("model name"):
            name = line.split(":", 1)[1].strip()
            break
    return f"{name}, {torch.backends.cpu.get_cpu_capability()}"

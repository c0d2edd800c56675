"""What a run folder says about how it came to be."""

from __future__ import annotations

import importlib.metadata
import json
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

from idapt_pl.files import write_atomically, write_json
from idapt_pl.modules.manual import computes_bfloat16
from idapt_pl.rendering.make import filament_is_used
from idapt_pl.run import without_retired

CHANGE_NOTHING = {
    "config", "trainer", "oracle", "ckpt_path", "weights_only", "predictions", "quality", "workers",
    "render_processes", "threads", "side_by_side",
}  # fmt: skip
"""Keys that may differ in a resumed run."""

PACKAGES = ("idapt", "torch", "torchvision", "lightning", "mujoco", "dm-control", "gymnasium", "numpy", "h5py")


@contextmanager
def claim(run_dir: Path) -> Iterator[None]:
    """Keep a run folder to this process: two must not write to one.

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
        yield
    finally:
        lock.release()


def write_provenance(parser: ArgumentParser, config: Namespace, run_dir: Path) -> None:
    """Write ``config.yaml`` (complete, re-runnable) and ``run.json``; a resumed run must have the same config.

    ``run.json`` says what the run was started with; every later start is added to its list ``resumed``.

    Raises:
        ValueError: if the folder holds a run with another config.
    """
    text = parser.dump(config, skip_none=False)
    path = run_dir / "config.yaml"
    if path.exists():
        defaults = yaml.safe_load(parser.dump(parser.get_defaults(), skip_none=False, skip_validation=True))
        before = filled(without_retired(yaml.safe_load(path.read_text())), defaults)
        if different := changed_keys(before, yaml.safe_load(text)):
            raise ValueError(
                f"{run_dir} holds a run with another config ({', '.join(different)} differ). "
                f"Choose another --run_dir, or resume with --config {path}."
            )
    write_atomically(path, lambda p: p.write_text(text))
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
    path = run_dir / "run.json"
    if path.exists():
        first = json.loads(path.read_text())
        now = first | {"resumed": [*first.get("resumed", []), now]}
    write_json(path, now)


def filled(config: dict, defaults: dict) -> dict:
    """A config with the defaults of keys that it does not have: it may be of a version that did not know them yet."""
    nested = {
        k: filled(config[k], v) for k, v in defaults.items() if isinstance(v, dict) and isinstance(config.get(k), dict)
    }
    return defaults | config | nested


def changed_keys(old: dict, new: dict, prefix: str = "") -> list[str]:
    """Dotted keys whose values differ, but for those that change nothing of what a run has done so far."""
    keys = []
    for key in sorted({*old, *new} - CHANGE_NOTHING):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            keys += changed_keys(a, b, f"{prefix}{key}.")
        elif a != b:
            keys.append(prefix + key)
    return keys


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

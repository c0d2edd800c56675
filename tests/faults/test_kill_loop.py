"""Runs that are killed again and again end bitwise like one that is not: nothing lost, counted twice or left behind."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest
import torch
from conftest import ROOT, TINY

KILLS = 13
"""Of each run."""
TEACHER = {"teacher.steps": 16, "teacher.adapt": 12, "teacher.dagger": 16}
ON_ESTIMATES = {
    "teacher.dagger": 0, "teacher.rehearse": 64, "policy.memory": 8, "filter.stretch": 10, "labels.members": 8,
    "schedule.source_policy": 0,
    **{f"schedule.{part}.{name}": n for part in ("pretrain", "finetune")
       for name, n in (("policy", 0), ("rehearsed", 4), ("filter", 6))},
}  # fmt: skip
"""Rehearsals in place of DAgger."""
RUNS = {
    "pendulum_quick": TEACHER
    | {
        "effects.discover": "true",
        "effects.looks": "true",
        "schedule.images": 200,
        "effects.candidates": "[body_mass,actuator_delay]",
        "effects.max_effects": 1,
    },
    "cheetah_quick": TEACHER | ON_ESTIMATES | {"schedule.exploration": "rehearse", "schedule.grounding_steps": 1},
    "cheetah_hard": TEACHER
    | ON_ESTIMATES
    | {
        "schedule.grounding_steps": 1,
        "schedule.action_transformation": "false",
        "schedule.images": 240,
        "schedule.paired_steps": 4,
        "teacher.harden": 12,
        "teacher.candidates": 2,
        "effects.discover": "true",
        "effects.candidates": "[joint_armature,joint_damping]",
        "effects.max_effects": 1,
    },
    "pendulum_hard": {"schedule.until_settled": "true", "schedule.rollback": "true"},
}
"""What each has beside TINY: together all stages. Few effects, or most kills would come while they are sought."""
STAGES = {
    "pendulum_quick": {"looks", "effects", "student", "dynamics"},
    "cheetah_quick": {"rehearsal_teacher", "filter_policy", "reading_errors", "labelled"},
    "cheetah_hard": {"replayed", "known_start_search", "trial_rehearsal", "hardened_filter_policy"},
    "pendulum_hard": {"convergence", "dynamics", "selection"},
}
"""Some that a run must have come through."""
FEWEST_KILLS = 7
LONGEST = 1800
"""Seconds that a tiny run may take beside whatever else there is."""
UNCOMPARED = ("run.json", "config.yaml", "report.html", "metrics.csv", "hparams.yaml")
"""Files that tell of when and where, or are drawn from others."""
TIMES = ("wall_s", "checksum")


def start(config: str, run: Path, side_by_side: bool) -> subprocess.Popen:
    values = TINY | RUNS[config] | {"run_dir": run, "side_by_side": str(side_by_side).lower(), "threads": 1}
    command = [sys.executable, "-m", "cli", "fit", "--config", ROOT / f"configs/{config}.yaml"]
    with (run.parent / f"{run.name}.log").open("a") as log:
        return subprocess.Popen(
            [*command, *(f"--{k}={v}" for k, v in values.items())], cwd=ROOT, stdout=log, stderr=log,
            env=os.environ | {"OMP_NUM_THREADS": "1", "IDAPT_RENDERER": "classic"}, start_new_session=True,
        )  # fmt: skip


def without_times(value):
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in TIMES}
    if isinstance(value, list) and value and isinstance(value[0], dict) and "stage" in value[0]:
        return sorted(map(without_times, value), key=str)  # they are in the order in which they ended
    return [without_times(v) for v in value] if isinstance(value, list) else value


def content(path: Path):
    """What a file holds, without how long it took."""
    if path.suffix == ".ckpt":
        return {k: v.numpy() for k, v in torch.load(path, weights_only=True)["state_dict"].items()}
    if path.suffix == ".h5":
        found = {}
        with h5py.File(path) as f:
            f.visititems(lambda name, item: found.update({name: item[()]} if isinstance(item, h5py.Dataset) else {}))
        return found
    if path.name == "ledger.json":
        return {str(i): str(e) for i, e in enumerate(sorted(json.loads(path.read_text())["entries"], key=str))}
    if path.name == "warnings.json":
        return {"warnings": sorted(json.loads(path.read_text())["warnings"])}  # processes beside warn when they do
    if path.suffix == ".json":
        return without_times(json.loads(path.read_text()))
    return path.read_bytes()


def files(run: Path) -> list[Path]:
    every = [p.relative_to(run) for p in run.rglob("*") if p.is_file()]
    drawn_or_locks = (".gif", ".lock")
    return sorted(
        p for p in every
        if p.name not in UNCOMPARED and p.suffix not in drawn_or_locks and not p.name.startswith("events.out.")
    )  # fmt: skip


def stages_of(run: Path) -> set[str]:
    """Stages that left their file or folder in some grounding step."""
    return {p.stem for p in run.glob("step_*/*")}


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    return bool(np.array_equal(a, b, equal_nan=True)) if isinstance(a, np.ndarray) and a.dtype.kind == "f" else (
        bool(np.array_equal(a, b)) if isinstance(a, np.ndarray) else a == b
    )  # fmt: skip


def at_work_in(run: Path) -> list[psutil.Process]:
    """Processes whose command names the run folder."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        if any(str(run) in part for part in process.info["cmdline"] or []):
            found.append(process)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("side_by_side", [False, True])
@pytest.mark.parametrize("config", RUNS)
def test_a_run_killed_at_random_ends_like_one_that_was_not(config, side_by_side, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    began = time.monotonic()
    assert start(config, whole, False).wait(LONGEST) == 0, (tmp_path / "whole.log").read_text()[-2000:]
    length, rng, kills = time.monotonic() - began, np.random.default_rng(len(config) + side_by_side), 0
    while True:
        process = start(config, killed, side_by_side)
        try:
            # mostly soon after it has begun anew, so that it takes many kills to get through
            code = process.wait(rng.uniform(0.05, 0.3) * length if kills < KILLS else LONGEST)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills += 1
            left = psutil.wait_procs(at_work_in(killed), timeout=5)[1]  # what works beside leaves when its pipe closes
            assert left == [], "a process outlived the one that started it"
            continue
        assert code == 0, (tmp_path / "killed.log").read_text()[-3000:]
        break
    print(f"{config}, side by side {side_by_side}: {kills} kills, {length:.0f} s uninterrupted")
    assert kills >= FEWEST_KILLS, "too few to say anything"
    assert stages_of(whole) >= STAGES[config]
    assert files(killed) == files(whole), "files that are missing, or left behind"
    assert [p for p in files(whole) if not same(content(killed / p), content(whole / p))] == []

"""What is each part of a policy on estimates worth? A finished run again without one, from where it matters on.

    python benchmarks/taken_away.py --runs runs/half_cheetah_hard_0 --parts labels hardening rounds
    python benchmarks/taken_away.py --runs runs/* --parts nothing          # their own rows, to compare with

The run's folder is copied to RUN_without_PART beside it, but for the stages that the part has a say in, and goes on
without the part to the end of step 0: from then on recordings of the target would differ too. Everything before (data,
G, source policy) is the same to the bit, so what differs is the part and chance. What is given after the options goes
to ``idapt fit``, such as ``--threads 1 --side_by_side false``. A row says which commit made it, and which the run that
it began from. ``mean`` is the target's; ``grounded`` is the grounded source's.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

from benchmarks import quick
from benchmarks.tables import read_rows, replace_rows

ALWAYS = r"policy|policy_in_grounded_and_target|evaluation|convergence|oracle.*"
"""Stages of step 0 that every part has a say in."""
LEARNED = r"(rehearsal|estimator|filter)_(teacher|policy)(_\d+)?"
HARDENED = r"trial_rehearsal|hardened_.*"
LABELS = r"reading_errors|reading_offsets|lost|labelled|replay_labelled|replay_agreement|estimator_replayed"
TEACHERS = r"teacher(_\d+)?|teacher_trials"
SEARCH = r"control|effects|known_start_search"
AGAIN = r"repaired_.*"
SOURCE = r"source_(start|policy)|source_(rehearsal|estimator|filter)_.*|direct_transfer"

PARTS: dict[str, tuple[dict[str, object], str]] = {
    "rounds": ({"teacher.rounds": 1}, r"(hardened_)?(rehearsal|estimator|filter)_policy_\d+"),
    "hardening": ({"teacher.harden": 0}, HARDENED),
    "labels": ({"labels.members": 0}, f"{LABELS}|{LEARNED}|{HARDENED}"),
    "stronger teacher": (
        {"teacher.adapt": 0, "teacher.candidates": 1, "teacher.afresh": 0, "teacher.harden": 0},
        f"{TEACHERS}|{LEARNED}|{HARDENED}",
    ),
    "beginning afresh": ({"teacher.afresh": 0}, f"{TEACHERS}|{LEARNED}|{HARDENED}"),
    "effects": (  # and no variants within their intervals
        {"effects.discover": "false", "randomisation.ranges": "null"},
        f"{SEARCH}|{AGAIN}|{LABELS}|{TEACHERS}|{LEARNED}|{HARDENED}",
    ),
    "repaired exploration": (
        {"schedule.repaired_visual": 0},
        f"{AGAIN}|{LABELS}|{TEACHERS}|{LEARNED}|{HARDENED}|student",
    ),
    "estimates": (  # a student without memory imitates the teacher on three frames
        {
            "policy.memory": 0,
            "teacher.rehearse": 0,
            "teacher.dagger": 12000,
            "teacher.harden": 0,
            "teacher.rounds": 1,
            "labels.members": 0,
        },
        f"{SOURCE}|estimator|{AGAIN}|{LABELS}|{LEARNED}|{HARDENED}",
    ),
}
"""What is switched off: its keys, and the stages of step 0 that are made again."""

FIELDS = (
    "task", "target", "seed", "without", "mean", "std", "grounded", "position_error", "velocity_error",
    "target_interactions", "minutes", "threads", "commit", "began_from", "cpu",
)  # fmt: skip


def fork(run: Path, part: str) -> Path:
    """The folder of a run again, with what a part has no say in; left as it is if it is there."""
    folder = run.with_name(f"{run.name}_without_{part.replace(' ', '_')}")
    if folder.exists():
        return folder
    again = re.compile(f"({PARTS[part][1]}|{ALWAYS})")

    def others(path: str, names: list[str]) -> set[str]:
        return {n for n in names if Path(path) == run / "step_00" and again.fullmatch(n.split(".")[0])}

    unfinished = folder.with_name(f"{folder.name}.copying")
    shutil.rmtree(unfinished, ignore_errors=True)
    shutil.copytree(run / "step_00", unfinished / "step_00", ignore=others)
    unfinished.rename(folder)
    return folder


def without(part: str) -> list[str]:
    """Options of ``idapt fit`` for a run that ends with step 0 and has not this part."""
    return [f"--{key}={value}" for key, value in (PARTS[part][0] | {"schedule.grounding_steps": 0}).items()]


def measured(run: Path, part: str, extra: list[str]) -> dict:
    """The row of a run without a part."""
    folder = run if part == "nothing" else fork(run, part)
    if not (folder / "summary.json").exists():
        options = ["--config", str(run / "config.yaml"), *without(part), f"--run_dir={folder}"]
        command = [sys.executable, "-m", "cli", "fit", *options, *extra]
        subprocess.run(command, cwd=ROOT, check=True)
    first = next(row for row in quick.rows(folder, "IDAPT") if row["grounding_step"] == 0)
    began_from = json.loads((run / "run.json").read_text())["git_commit"]
    alone = {"minutes": "", "target_interactions": ""} if part == "nothing" else {}  # of all its steps
    row = {**first, **alone, "without": part, "began_from": began_from}
    return {name: row[name] for name in FIELDS if name in row}


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of finished runs")
    p.add_argument("--parts", nargs="+", choices=["nothing", *PARTS], default=["nothing", *PARTS])
    p.add_argument("--out", type=Path, default=ROOT / "results/taken_away.csv")
    o, extra = p.parse_known_args()
    for run in o.runs:
        for part in o.parts:
            row = measured(run.resolve(), part, extra)
            replace_rows(o.out, [row], ("task", "target", "seed", "without"), FIELDS)
            print({k: row.get(k) for k in ("task", "seed", "without", "mean", "grounded")}, flush=True)
    print(len(read_rows(o.out)), "rows in", o.out)


if __name__ == "__main__":
    main()

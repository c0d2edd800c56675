"""Does `idapt diagnose` name what is missing, and nothing where nothing is? One row a case and seed.

    python benchmarks/diagnosis.py --seeds 0 1 2            # all cases; finished rows are kept
    python benchmarks/diagnosis.py --cases servo_lag --seeds 0
    python benchmarks/diagnosis.py --positions --seeds 0    # without the velocities
    python benchmarks/diagnosis.py --summary                # the table of what is there

The recordings come from benchmarks/undeclared, which shares no code with the diagnosis. Writes results/diagnosis.csv.
``ceiling`` is what a black box (regression on state and commands) that corrects the nominal model would leave; further
baselines are in benchmarks/diagnosis_baselines.py.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.undeclared.cases import CASES, Case
from benchmarks.undeclared.generate import generate
from benchmarks.undeclared.models import UNSEEN
from cli.provenance import git_commit
from datamodules import Trajectories, read_trajectories
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "case", "kind", "model", "seed", "verdict", "found", "estimate", "truth", "right", "top1", "false_alarm",
    "before", "after", "ceiling", "removed_share", "relative_error", "covered", "class_size", "seconds", "cpu_seconds",
    "commit",
)  # fmt: skip


def score(case: Case, report: dict) -> dict:
    """Compare a report with the case's truth."""
    physical = [e for e in report["effects"] if e["effect"] != "numerics"]
    names = [(e["effect"], e["target"]) for e in physical]
    classes = [
        [n, *((q["effect"], q["target"]) for q in e["equivalent"])] for n, e in zip(names, physical, strict=True)
    ]
    accepted = set().union(*case.accept) if case.accept else set()
    if case.kind == "control":
        right = not names and (report["verdict"] == "no_missing_effect" or case.may_abstain)
    elif case.kind == "outside":
        right = report["verdict"] == "unexplained_residual"
    else:
        right = report["verdict"] == "effects_found" and any(
            len(answer - {("numerics", "world")}) == len(names) and all(any(m in answer for m in c) for c in classes)
            for answer in case.accept
        )
    return {
        "right": int(right),
        "top1": int(bool(classes) and any(m in accepted for m in classes[0])) if accepted else "",
        "false_alarm": int(bool(names)) if case.kind == "control" else "",
        "class_size": np.mean([len(c) for c in classes]) if classes else "",
        **estimate(case, physical),
    }


def estimate(case: Case, physical: list[dict]) -> dict:
    """Parameter error and interval coverage, for truths that were named and can be compared."""
    errors, covered = [], []
    for truth in case.truth:
        for e in physical:
            p = e["parameters"].get(truth.parameter)
            if (e["effect"], e["target"]) == (truth.effect, truth.target) and p and truth.value is not None:
                errors.append(abs(p["estimate"] - truth.value) / max(abs(truth.value - (p["nominal"] or 0.0)), 1e-12))
                covered.append(p["ci95"][0] <= truth.value <= p["ci95"][1])
    if not errors:
        return {"relative_error": "", "covered": ""}
    return {"relative_error": round(float(np.mean(errors)), 5), "covered": float(np.mean(covered))}


def positions_alone(data: Trajectories) -> Trajectories:
    """Recordings without their velocities."""
    kept = [replace(e, observations={k: v for k, v in e.observations.items() if k != "qvel"}) for e in data]
    return replace(data, episodes=tuple(kept))


def record(case: Case, seed: int, o: argparse.Namespace) -> tuple[mujoco.MjSpec, Trajectories]:
    """The nominal model and the recordings of a case."""
    nominal, measured = generate(case, seed, o.data / case.name / f"seed{seed}")
    data = read_trajectories(measured)
    return mujoco.MjSpec.from_file(str(nominal)), positions_alone(data) if o.positions else data


def run(case: Case, seed: int, o: argparse.Namespace) -> dict:
    """Record, diagnose, score."""
    model, data = record(case, seed, o)
    started, used = time.perf_counter(), time.process_time()
    report = diagnose(model, data, seed=seed).report
    seconds, cpu = time.perf_counter() - started, time.process_time() - used
    shown = [f"{e['effect']}({e['target']})" for e in report["effects"]]
    values = [f"{k}={p['estimate']}" for e in report["effects"] for k, p in e["parameters"].items()]
    return {
        "case": case.name, "kind": case.kind, "model": case.model, "seed": seed, "verdict": report["verdict"],
        "found": " + ".join(shown), "estimate": " ".join(values),
        "truth": " + ".join(f"{t.effect}({t.target})={t.value}" for t in case.truth),
        **{k: report["error"][k] for k in ("before", "after", "ceiling", "removed_share")},
        **score(case, report), "seconds": round(seconds, 1), "cpu_seconds": round(cpu, 1),
        "commit": git_commit(),
    }  # fmt: skip


def in_order(rows: list[dict]) -> list[dict]:
    """By model, case and seed."""
    return sorted(rows, key=lambda r: (r.get("optimizer", ""), r["kind"], r["case"], int(r["seed"])))


def summarise(rows: list[dict]) -> str:
    """The figures that matter, in a few lines."""

    def mean(name: str, chosen: list[dict]) -> str:
        values = [float(r[name]) for r in chosen if r.get(name, "") != ""]
        return f"{np.mean(values):.3f} (n = {len(values)})" if values else "-"

    named = [r for r in rows if r["kind"] in ("single", "double", "confounded")]
    controls = [r for r in rows if r["kind"] == "control"]
    outside = [r for r in rows if r["kind"] == "outside"]
    removed = [float(r["removed_share"]) for r in named]
    errors = [float(r["relative_error"]) for r in named if r["relative_error"] != ""]
    seconds = [float(r["seconds"]) for r in rows]
    return "\n".join(
        [
            f"top-1, identifiable cases         {mean('top1', named)}",
            f"whole answer right                {mean('right', named)}",
            f"outside the library: unexplained  {mean('right', outside)}",
            f"controls: false alarms            {mean('false_alarm', controls)}",
            f"removable error removed, median   {np.median(removed):.3f}" if removed else "",
            f"parameter error, median           {np.median(errors):.4f}" if errors else "",
            f"95 % intervals that cover         {mean('covered', named)}",
            f"seconds a case, median / max      {np.median(seconds):.0f} / {max(seconds):.0f}",
        ]
    )


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", nargs="+", choices=sorted(CASES), default=list(CASES), metavar="CASE")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--positions", action="store_true", help="leave the measured velocities out")
    p.add_argument("--again", action="store_true", help="repeat rows that are there")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "undeclared")
    p.add_argument("--out", type=Path, help="default results/diagnosis.csv, or diagnosis_positions.csv")
    o = p.parse_args()
    o.out = o.out or ROOT / "results" / f"diagnosis{'_positions' * o.positions}.csv"
    rows = read_rows(o.out)
    wanted = [(c, s) for s in o.seeds for c in o.cases] if not o.summary else []
    for name, seed in tqdm(wanted, unit="case", disable=not sys.stderr.isatty()):
        same = [r for r in rows if (r["case"], int(r["seed"])) == (name, seed)]
        if same and not o.again:
            continue
        row = run(CASES[name], seed, o)
        rows = [r for r in rows if r not in same] + [row]
        write_rows(o.out, in_order(rows), FIELDS)
        r = rows[-1]
        errors = f"{float(r['before']):.3g} -> {float(r['after']):.3g}"
        print(
            f"{name:32s} {seed} right={r['right']} {r['verdict']:22s} {r['found']} | {r['truth']} | {errors}",
            flush=True,
        )
    for title, late in (("models that it was developed on", False), ("other models", True)):
        if chosen := [r for r in rows if (r["model"] in UNSEEN) == late]:
            print(f"--- {title}\n{summarise(chosen)}")


if __name__ == "__main__":
    main()

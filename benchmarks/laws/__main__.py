"""Does `idapt diagnose` say a law for what its library does not have, and none where there is nothing to say?

    python -m benchmarks.laws --seeds 0                # all cases; finished rows are kept
    python -m benchmarks.laws --held-out --seeds 1 2   # those that nothing was tuned on
    python -m benchmarks.laws --summary

Each row plants one force (benchmarks/laws/cases.py) in a model, integrated otherwise than the model that is diagnosed,
with noise. Writes results/laws.csv. ``removed_library`` is the share of the removable held-out error (squared) that
effects of the library remove, ``removed`` the share with laws or a black box.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
from tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.laws.cases import PLANTED, PlantedLaw
from benchmarks.laws.models import register_models
from benchmarks.undeclared.generate import generate
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import Diagnosis, diagnose

FIELDS = (
    "case", "kind", "model", "tuned", "seed", "verdict", "library", "law", "joint", "depends", "truth_joint",
    "truth_depends", "right_joint", "right_depends", "unexplained", "black_box", "sensor", "false_law", "before",
    "after_library", "after", "removed_library", "removed", "seconds", "law_seconds", "cpu_seconds", "commit",
)  # fmt: skip

FOLLOWS = {
    "joint_damping": "v", "joint_drag": "v", "joint_frictionloss": "v", "joint_stribeck": "v", "joint_stiffness": "q",
    "joint_springref": "q", "joint_cogging": "q", "actuator_gain": "u", "actuator_saturation": "u",
    "actuator_deadzone": "u", "actuator_kp": "u",
}  # fmt: skip
"""What effects of the library follow, where they are all that is found."""


def share(before: float, after: float) -> float:
    """Of the removable squared error that was removed."""
    return round((before**2 - after**2) / max(before**2 - 1.0, 1e-9), 4) if before > 1.05 else 0.0


def answer(diagnosis: Diagnosis) -> tuple[str, set[str]]:
    """The joint and the dependence that a diagnosis names: of its laws, else of what it found in the library."""
    laws = diagnosis.result.laws
    if laws is not None and laws.found:
        depends = {s.replace("motor", "u") for f in laws.found for s in f.depends}
        return " ".join(sorted({f.joint for f in laws.found})), {"history"} if "history" in depends else depends
    found = [e for e in diagnosis.result.effects if e.effect in FOLLOWS]
    model = diagnosis.sim.model
    only = model.joint(0).name if model.njnt == 1 else "*"
    joints = {only if e.target in ("*", "actuated") else e.target for e in found}
    return " ".join(sorted(joints)), {FOLLOWS[e.effect] for e in found}


def score(planted: PlantedLaw, diagnosis: Diagnosis) -> dict:
    """What was named, and whether it is right."""
    laws, error = diagnosis.result.laws, diagnosis.result.error
    joint, depends = answer(diagnosis)
    library = [e for e in diagnosis.result.effects if e.effect != "learned_force"]
    middle = laws.before if laws is not None else error.after
    after = laws.after if laws is not None else error.after
    is_law = planted.kind == "law"
    return {
        "library": " + ".join(f"{e.effect}({e.target})" for e in library),
        "law": " ; ".join(f"{f.joint}: {f.formula}" for f in laws.found) if laws is not None else "",
        "joint": joint,
        "depends": " ".join(sorted(depends)),
        "truth_joint": planted.joint,
        "truth_depends": " | ".join(" ".join(sorted(d)) for d in planted.depends),
        "right_joint": int(joint == planted.joint) if is_law else "",
        "right_depends": int(depends in planted.depends) if is_law else "",
        "unexplained": int(not (laws and laws.found) and diagnosis.verdict.value == "unexplained_residual"),
        "black_box": int(laws is not None and laws.network is not None),
        "sensor": laws.sensor if laws is not None else "",
        "false_law": int(laws is not None and bool(laws.found)) if not is_law else "",
        "before": error.before,
        "after_library": middle,
        "after": after,
        "removed_library": share(error.before, middle),
        "removed": share(error.before, after),
        "law_seconds": laws.seconds if laws is not None else 0.0,
    }


def run(name: str, seed: int, data: Path) -> dict:
    """Record, diagnose, score."""
    planted = PLANTED[name]
    nominal, measured = generate(planted.case, seed, data / name / f"seed{seed}")
    started, used = time.perf_counter(), time.process_time()
    diagnosis = diagnose(mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured), seed=seed, threads=1)
    return {
        "case": name, "kind": planted.kind, "model": planted.case.model, "tuned": int(planted.tuned and seed == 0),
        "seed": seed, "verdict": diagnosis.verdict.value, **score(planted, diagnosis),
        "seconds": round(time.perf_counter() - started, 1), "cpu_seconds": round(time.process_time() - used, 1),
        "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """The figures that matter, in a few lines."""

    def rate(name: str, chosen: list[dict]) -> str:
        values = [float(r[name]) for r in chosen if r[name] != ""]
        return f"{sum(values):.0f} of {len(values)}" if values else "-"

    laws = [r for r in rows if r["kind"] == "law"]
    half = [r for r in laws if float(r["removed"]) >= 0.5]
    both = [r for r in laws if r["right_joint"] == r["right_depends"] == "1"]
    lines = [
        f"half of the removable error removed   {len(half)} of {len(laws)}",
        f"right joint                           {rate('right_joint', laws)}",
        f"right joint and dependence            {len(both)} of {len(laws)}",
        f"left as unexplained                   {rate('unexplained', laws)}",
    ]
    for kind, words in (("nothing", "nothing there"), ("library", "a library effect"), ("sensor", "a sensor")):
        lines.append(f"laws where there is {words:18s}{rate('false_law', [r for r in rows if r['kind'] == kind])}")
    return "\n".join(lines)


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", nargs="+", choices=sorted(PLANTED), metavar="CASE")
    p.add_argument("--held-out", action="store_true", help="only the cases that the search was not developed on")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--again", action="store_true", help="repeat rows that are there")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "laws")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "laws.csv")
    o = p.parse_args()
    register_models()
    rows = read_rows(o.out)
    names = o.cases or [n for n, planted in PLANTED.items() if not (o.held_out and planted.tuned)]
    wanted = [(n, s) for s in o.seeds for n in names] if not o.summary else []
    for name, seed in tqdm(wanted, unit="case", disable=not sys.stderr.isatty()):
        same = [r for r in rows if (r["case"], int(r["seed"])) == (name, seed)]
        if same and not o.again:
            continue
        rows = [r for r in rows if r not in same] + [{k: str(v) for k, v in run(name, seed, o.data).items()}]
        order = list(PLANTED)
        write_rows(o.out, sorted(rows, key=lambda r: (order.index(r["case"]), int(r["seed"]))), FIELDS)
        r = rows[-1]
        print(
            f"{name:28s} {seed} removed {r['removed_library']} -> {r['removed']} {r['law']} | {r['library']}",
            flush=True,
        )
    for words, chosen in (
        ("in sight while tuning", [r for r in rows if r["tuned"] == "1"]),
        ("other seeds of the same cases", [r for r in rows if r["tuned"] != "1" and PLANTED[r["case"]].tuned]),
        ("cases held back", [r for r in rows if not PLANTED[r["case"]].tuned]),
    ):
        if chosen:
            print(f"--- {words}\n{summarise(chosen)}")


if __name__ == "__main__":
    main()

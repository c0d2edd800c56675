"""Would changes as small as a report says have been seen? One row a model, hidden change, size and seed.

    python benchmarks/detection_limits.py --models hopper reacher --seeds 2     # finished rows are kept
    python benchmarks/detection_limits.py --summary                             # the table of what is there

A recording with nothing hidden is diagnosed, which says from which size on usual changes would have been seen. Some of
these changes, drawn by the seed, are then hidden at a quarter, a half, once and twice that size, and recorded anew.
Writes results/detection_limits.csv: ``seen`` where anything physical is named, ``named`` where that is what was hidden,
first or among what it could also be.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from benchmarks.tables import read_rows, write_rows

from benchmarks.undeclared import hidden
from benchmarks.undeclared.cases import SAME, Case
from benchmarks.undeclared.generate import generate
from benchmarks.undeclared.hidden import Part
from benchmarks.undeclared.models import MODELS, nominal_xml
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.answer.detection_limits import DetectionLimit
from idapt_pl.diagnosis.search import Diagnosis, diagnose

FIELDS = (
    "model", "effect", "target", "parameter", "nominal", "limit", "unit", "times", "seed", "seen", "named", "found",
    "verdict", "seconds", "commit",
)  # fmt: skip
SIZES = (0.25, 0.5, 1.0, 2.0)
"""Times the size from which a change is said to be seen."""
HIDE: dict[str, Callable[[str, float], Part]] = {
    "joint_damping": hidden.joint_damping,
    "joint_frictionloss": hidden.joint_frictionloss,
    "joint_armature": hidden.joint_armature,
    "body_mass": hidden.body_mass,
    "actuator_gain": hidden.motor_gain,
    "actuator_kp": hidden.servo_stiffness,
}
"""How what a report has limits of is hidden, by writing MJCF."""
SCALED = {"actuator_gain": "gear", "actuator_kp": "kp"}
"""Attributes of actuators that are scaled; not all have them."""


def diagnosis_of(model: str, parts: Sequence[Part], seed: int) -> Diagnosis:
    """Record with this hidden, and diagnose."""
    truth = tuple(p.truth for p in parts)
    kind = "single" if parts else "control"
    case = Case(f"limit_{model}", model, truth, kind, (), tuple(parts), SAME, MODELS[model].noise)
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    return diagnose(spec, data, seed=seed, laws=False)


def drawn_limits(model: str, limits: Sequence[DetectionLimit], count: int, seed: int) -> list[DetectionLimit]:
    """Some of the limits that the MJCF of a model can be changed by."""
    motors = ET.fromstring(nominal_xml(model)).find("actuator")
    written = {(effect, m.get("name")) for m in motors for effect, name in SCALED.items() if m.get(name)}
    of = [x for x in limits if x.effect in HIDE and np.isfinite(x.change)]
    of = [x for x in of if x.effect not in SCALED or (x.effect, x.target) in written]
    rng = np.random.default_rng([seed, zlib.crc32(model.encode())])
    return [of[i] for i in rng.permutation(len(of))[:count]]


def run(model: str, x: DetectionLimit, times: float, seed: int) -> dict:
    """Hide one change and look for it."""
    started = time.perf_counter()
    report = diagnosis_of(model, [HIDE[x.effect](x.target, x.nominal + times * x.change)], seed).report
    physical = [e for e in report["effects"] if e["effect"] != "numerics"]
    names = {(q["effect"], q["target"]) for e in physical for q in (e, *e["equivalent"])}
    return {
        "model": model, "effect": x.effect, "target": x.target, "parameter": x.parameter, "nominal": x.nominal,
        "limit": x.change, "unit": x.unit, "times": times, "seed": seed, "seen": int(bool(physical)),
        "named": int((x.effect, x.target) in names),
        "found": " ".join(f"{e['effect']}({e['target']})" for e in physical),
        "verdict": report["verdict"], "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row a size."""
    lines = ["| times the size said | hidden | seen | named |", "|---|---|---|---|"]
    for times in sorted({float(r["times"]) for r in rows}):
        of = [r for r in rows if float(r["times"]) == times]
        seen, named = (sum(int(r[k]) for r in of) for k in ("seen", "named"))
        lines.append(f"| {times:g} | {len(of)} | {seen} | {named} |")
    return "\n".join(lines)


def main() -> None:
    """Run what has no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=["inverted_pendulum"], choices=sorted(MODELS))
    p.add_argument("--seeds", nargs="+", type=int, default=[1])
    p.add_argument("--count", type=int, default=3, help="changes that are hidden, of each model and seed")
    p.add_argument("--summary", action="store_true", help="only print the table of what is there")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "detection_limits.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    for model, seed in [] if o.summary else itertools.product(o.models, o.seeds):
        if any(r["model"] == model and int(r["seed"]) == seed for r in rows):
            continue
        limits, new = diagnosis_of(model, [], seed).result.limits, []
        for x, times in itertools.product(drawn_limits(model, limits, o.count, seed), SIZES):
            new.append(run(model, x, times, seed))
            print({k: new[-1][k] for k in FIELDS[:12]}, flush=True)
        rows += new
        write_rows(o.out, rows, FIELDS)
    print(summarise(rows))


if __name__ == "__main__":
    main()

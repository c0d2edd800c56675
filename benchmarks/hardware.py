"""What does `idapt diagnose` find in recordings of real machines, and how much error goes?

    python benchmarks/hardware.py FOLDER [--rigs double_pendulum xl330 xl330_torque_off so101] [--report DIR]

FOLDER holds double_pendulum/, xl330_pendulum/ and so101_arm/, each with nominal.xml and measured.h5 (published
recordings; docs/reference/hardware.md names the sources). They are not part of this repository. Writes
results/hardware.csv, one row a rig, channel and processor: root-mean-square prediction error on held-out episodes
before and after, and what was found.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import h5py
from tables import read_rows, write_rows

from cli.provenance import cpu_model, git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.model import read_model
from idapt_pl.report.diagnosis_files import write_diagnosis

FIELDS = (
    "rig", "channel", "unit", "before", "after", "ratio", "verdict", "found", "horizon_s", "held_out", "seconds",
    "commit", "cpu",
)  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """Files of a rig, and the names of the episodes held out (as its recorders' names contain them)."""

    folder: str
    model: str
    data: str
    held_out: tuple[str, ...]


RIGS = {
    "double_pendulum": Rig("double_pendulum", "nominal.xml", "measured.h5", ("trajectory_05", "trajectory_11")),
    "xl330": Rig("xl330_pendulum", "nominal.xml", "measured.h5", ("kp400_sin_time_square", "kp800_lift_and_drop")),
    "xl330_torque_off": Rig(
        "xl330_pendulum", "nominal_torque_off.xml", "measured_torque_off.h5", ("kp800_lift_and_drop",)
    ),
    "so101": Rig("so101_arm", "nominal.xml", "measured.h5", ("pick_place", "oscillation_med_freq", "coupled_joints")),
}


def held_out(path: Path, names: tuple[str, ...]) -> list[int]:
    """Indices of the episodes whose names contain one of ``names``; all attributes of an episode are looked at."""
    found = []
    with h5py.File(path) as f:
        for i in range(int(f.attrs["total_episodes"])):
            text = " ".join(str(v) for v in f[f"episode_{i}"].attrs.values())
            found += [i] * any(n in text for n in names)
    if not found:
        raise SystemExit(f"{path}: no episode is called {' or '.join(names)}")
    return found


def run(folder: Path, name: str, report_to: Path | None) -> list[dict]:
    """Diagnose one rig; rows of the table."""
    rig = RIGS[name]
    model, data = folder / rig.folder / rig.model, folder / rig.folder / rig.data
    started = time.perf_counter()
    out = diagnose(read_model(model), read_trajectories(data), hold_out=held_out(data, rig.held_out))
    seconds = time.perf_counter() - started
    if report_to is not None:
        write_diagnosis(out, report_to / name, str(model.name), str(data.name))
    found = [
        f"{e['effect']}({e['target']}) "
        + " ".join(f"{k}={p['estimate']:.4g}" for k, p in e["parameters"].items() if p["ci95"])
        for e in out.report["effects"]
    ]
    error = out.report["error"]
    return [
        {
            "rig": name, "channel": channel, "unit": v["unit"], "before": v["before"], "after": v["after"],
            "ratio": round(v["before"] / v["after"], 2), "verdict": out.report["verdict"], "found": " + ".join(found),
            "horizon_s": error["horizon_s"], "held_out": " ".join(rig.held_out), "seconds": round(seconds, 1),
            "commit": git_commit(), "cpu": cpu_model(),
        }
        for channel, v in error["per_channel"].items()
    ]  # fmt: skip


def main() -> None:
    """Run the rigs and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("folder", type=Path)
    p.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    p.add_argument("--report", type=Path, help="write each rig's report below this folder")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "hardware.csv")
    o = p.parse_args()
    if not o.folder.is_dir():
        print(f"{o.folder} is not there: nothing to do")
        return
    kept = [r for r in read_rows(o.out) if r["rig"] not in o.rigs or r["cpu"] != cpu_model()]
    for name in o.rigs:
        kept += run(o.folder, name, o.report)
        write_rows(o.out, kept, FIELDS)
        for r in kept:
            if (r["rig"], r["cpu"]) == (name, cpu_model()):
                print({k: r[k] for k in FIELDS[:8]}, r["seconds"], "s", flush=True)


if __name__ == "__main__":
    main()

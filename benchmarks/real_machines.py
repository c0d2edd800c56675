"""Published recordings of real machines, from the files as they are to what is found: one row a set.

    git clone https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum CLONES/simple_pendulum
    git clone https://github.com/unisa-acg/inverse-dynamics-solver CLONES/inverse_dynamics_solver
    pip download --no-deps robosuite==1.5.2 && unzip -qd CLONES/robosuite robosuite-*.whl
    git clone https://github.com/dfki-ric-underactuated-lab/ricmonk CLONES/ricmonk
    pip install "idapt[benchmarks]"
    python benchmarks/real_machines.py CLONES [--sets pendulum] [--report DIR]

Files are imported with the map that `idapt import --draft-map` writes, unread, where names in the log are those of the
model (else with the map that stands here), and diagnosed with all defaults but for which episodes are held out. Beside
it, on the same windows: a plain fit, as by hand (damping, dry friction and rotor inertia of every joint at once),
CMA-ES over what PACE fits, and mujoco.sysid on all single numbers. Errors are root mean squares of whitened predictions
of held-out episodes. Writes results/real_machines.csv. Nothing of the recordings is committed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from tables import read_rows, write_rows

from benchmarks.other_fits import by_hand, pace, sysid_fit
from cli.diagnose_recordings import more_than_one
from cli.main import main as idapt
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import Diagnosis, diagnose
from idapt_pl.report.diagnosis_files import write_diagnosis
from idapt_pl.robot_files import parse_actuators, read_robot

FIELDS = (
    "set", "episodes", "rows", "joints", "held_out", "before", "plain_fit", "pace", "sysid", "after", "verdict",
    "found", "known", "seconds", "threads", "source", "commit",
)  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """A set of recordings.

    Attributes:
        clone: folder below that of the clones, a git repository; empty where it is none.
        files: of the recordings, below the clone.
        model: MJCF or URDF, below the folder of clones or, of a repository, below the clone.
        actuators: as of ``idapt diagnose --actuators``, for a model without.
        known: what is known about the truth.
        hold_out: numbers of the episodes to judge on; None for the default.
        map: a map, where the log has other names than the model; empty: a draft.
    """

    clone: str
    files: tuple[str, ...]
    model: str
    actuators: str | None
    known: str
    hold_out: tuple[int, ...] | None = None
    map: str = ""


RICMONK_MAP = """
time: {column: meas_time, unit: s}
joints:
  virtul_joint_hook_1: {position: arm1_meas_Ang_pos, velocity: arm1_meas_Ang_vel}
  Joint1: {position: tail_meas_Ang_pos, velocity: tail_meas_Ang_vel}
  Joint3: {position: phi_meas_Ang_pos, velocity: phi_meas_Ang_vel}
actuators: {Joint1: tail_clipped_tau, Joint3: phi_clipped_tau}
"""

PENDULUM = "results/control_method_{}/data_measured.csv"
SETS = {
    "pendulum": Recorded(
        "simple_pendulum",
        tuple(PENDULUM.format(m) for m in (
            "ddp", "direct_collocation", "pd/system_identification", "sac", "ilqr",
            "pd/1nm_torque_limited_swingup_failure")),
        "data/urdf/dfki_simple_pendulum.urdf", "motor",
        "inertia and weight by regression of two recordings: 1.3 and 1.2 times the URDF's; friction 0.18 to 0.25 N m",
    ),
    "pendulum_bang_bang": Recorded(
        "simple_pendulum", (PENDULUM.format("energy_shaping"),), "data/urdf/dfki_simple_pendulum.urdf", "motor",
        "torque goes with the direction of motion throughout: friction, dead zone and mass cannot be told apart",
    ),
    "ricmonk": Recorded(
        "ricmonk", tuple(f"results/singleBrachiation_tvlqr/TVLQR_{m}/measured.csv" for m in ("BF", "FB", "ZB", "ZF")),
        "data/simulation_models/finalRicMonkCurrent.urdf", "motor",
        "it lets go and catches a bar; motors with gears 6:1", map=RICMONK_MAP,
    ),
    "panda": Recorded(
        "inverse_dynamics_solver", ("franka_inria_inverse_dynamics_solver/bagfiles/panda_exciting_trajectory.db3",),
        "robosuite/robosuite/models/assets/robots/panda/robot.xml", None, "",
    ),
}  # fmt: skip


def fetched(clones: Path, which: Recorded, folder: Path) -> tuple[list[Path], Path]:
    """The recordings and the model as files, those of a repository read out of its newest commit."""
    clone = clones / which.clone

    def taken(path: str) -> Path:
        out = folder / path.replace("/", "_")
        command = ["git", "-C", clone, "show", f"HEAD:{path}"]
        out.write_bytes(subprocess.run(command, check=True, capture_output=True).stdout)
        return out

    model = clones / which.model
    return [taken(f) for f in which.files], model if model.is_file() else taken(which.model)


def run(name: str, clones: Path, threads: int, report_to: Path | None) -> dict:
    """Import, diagnose, and fit by other means."""
    which = SETS[name]
    with tempfile.TemporaryDirectory() as folder:
        files, model = fetched(clones, which, Path(folder))
        drive = ["--actuators", which.actuators] if which.actuators else []
        recorded, known = Path(folder, "recorded.h5"), ["--model", str(model), *drive]
        map_file, failed = Path(folder, "map.yaml"), 0
        if which.map:
            map_file.write_text(which.map)
        else:
            failed = idapt(["import", *known, "--draft-map", str(map_file), str(files[0])])
        if failed or idapt(
            ["import", *known, "--map", str(map_file), *map(str, files), "--out", str(recorded), "--repair"]
        ):
            raise SystemExit(f"{name}: its files were not read")
        robot = read_robot(model, parse_actuators(which.actuators) if which.actuators else None)
        data = more_than_one(read_trajectories(recorded))
        started = time.perf_counter()
        out = diagnose(robot.spec, data, hold_out=which.hold_out, threads=threads)
        seconds = time.perf_counter() - started
    if report_to is not None:
        write_diagnosis(out, report_to / name, model.name, name)
    error = out.report["error"]
    found = [
        f"{e['effect']}({e['target']}) " + " ".join(f"{k}={p['estimate']:.4g}" for k, p in e["parameters"].items())
        for e in out.report["effects"]
    ]
    commit = ["git", "-C", clones / which.clone, "log", "-1", "--format=%h"]
    source = subprocess.run(commit, check=True, capture_output=True, text=True).stdout.strip()
    return {
        "set": name, "episodes": len(data), "rows": data.total_steps, "joints": out.sim.model.nv,
        "held_out": " ".join(map(str, error["held_out_episodes"])), "before": error["before"],
        "plain_fit": round(by_hand(out.context, out.state), 4), "pace": round(pace(out.context, out.state), 4),
        "sysid": by_sysid(out, robot.spec), "after": error["after"], "verdict": out.report["verdict"],
        "found": " + ".join(found), "known": which.known, "seconds": round(seconds, 1), "threads": threads,
        "source": source, "commit": git_commit(),
    }  # fmt: skip


def by_sysid(out: Diagnosis, spec: mujoco.MjSpec) -> float | str:
    """Held-out error after mujoco.sysid; in words why there is none."""
    try:
        return round(sysid_fit(out.context, out.state, out.state.windows.fit.windows, spec, "mujoco", 100).after, 4)
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        return f"failed: {' '.join(str(error).split())[:80]}"


def main() -> None:
    """Run the sets and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("clones", type=Path)
    p.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--report", type=Path, help="write each set's report below this folder")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "real_machines.csv")
    o = p.parse_args()
    rows = {r["set"]: r for r in read_rows(o.out)}
    for name in o.sets:
        if not (o.clones / SETS[name].clone).is_dir():
            print(f"{o.clones / SETS[name].clone} is not there: {name} is left out")
            continue
        rows[name] = run(name, o.clones, o.threads, o.report)
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
        print({k: rows[name][k] for k in FIELDS[:12]}, flush=True)


if __name__ == "__main__":
    main()

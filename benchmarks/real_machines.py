"""Published recordings of real machines, from the files as they are to what is found: one row a set.

    git clone https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum CLONES/simple_pendulum
    git clone https://github.com/unisa-acg/inverse-dynamics-solver CLONES/inverse_dynamics_solver
    pip download --no-deps robosuite==1.5.2 && unzip -qd CLONES/robosuite robosuite-*.whl
    git clone https://github.com/dfki-ric-underactuated-lab/ricmonk CLONES/ricmonk
    git clone https://github.com/thanhndv212/figaroh-examples CLONES/figaroh_examples
    pip install "idapt[benchmarks]"
    python benchmarks/real_machines.py CLONES [--sets pendulum] [--report DIR]

Files are imported with the map that `idapt import --draft-map` writes, unread, where names in the log are those of the
model (else with the map that stands here), and diagnosed as `idapt diagnose` does without options: deployment faults
first, then effects and laws, then once more without the stretches in which the model cannot hold. Beside it, on the
same windows: a plain fit, as by hand (damping, dry friction and rotor inertia of every joint at once), CMA-ES over what
PACE fits, and mujoco.sysid on all single numbers (by forecasts). Errors are of held-out episodes: root mean squares of
whitened forecasts, or of forces where noise is no yardstick. Writes results/real_machines.csv. Nothing of the
recordings is committed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "results" / "real_machines.csv"
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import numpy as np
from mujoco import sysid
from scipy.signal import butter, filtfilt
from tables import read_rows, write_rows

from benchmarks.fewer_gates import judged_by
from benchmarks.other_fits import by_hand, pace, sysid_fit
from cli.diagnose import command_line
from cli.diagnose_recordings import diagnose_recordings
from cli.main import main as idapt
from cli.provenance import git_commit
from idapt_pl.diagnosis.search import Diagnosis

FIELDS = (
    "set", "episodes", "rows", "joints", "held_out", "judged_by", "before", "plain_fit", "pace", "sysid", "after",
    "verdict", "found", "faults", "left_out", "known", "seconds", "threads", "licence", "source", "commit",
)  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """A set of recordings.

    Attributes:
        clone: folder below that of the clones, a git repository; empty where it is none.
        files: of the recordings, below the clone.
        model: MJCF or URDF, below the folder of clones or the clone, or ``clone:path`` of another one.
        actuators: as of ``idapt diagnose --actuators``, for a model without.
        known: what is known about the truth.
        licence: of the recordings.
        map: a map, where the log has other names than the model; empty: a draft.
        prepare: makes of the files, (and of the folder for it), a table that can be imported.
    """

    clone: str
    files: tuple[str, ...]
    model: str
    actuators: str | None
    known: str
    licence: str
    map: str = ""
    prepare: Callable[[list[Path], Path], Path] | None = None


TX40_RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
TX40_JOINTS = [f"joint_{i}" for i in range(1, 7)]
TX40_MAP = "time: {{column: t, unit: s}}\njoints:\n{}\nactuators:\n{}\n".format(
    "\n".join(f"  {j}: {{position: q_{j}, velocity: v_{j}}}" for j in TX40_JOINTS),
    "\n".join(f"  {j}: tau_{j}" for j in TX40_JOINTS),
)


def tx40_table(files: list[Path], folder: Path) -> Path:
    """Motors' positions and torques at 5 kHz as the joints' at 200 Hz, as its publisher converts them.

    Positions are low-passed at 100 Hz, velocities are their slopes, torques are means over what is left out. The sixth
    motor turns with the fifth joint.
    """
    motors, torques = (np.loadtxt(f, delimiter=",", skiprows=1) for f in files)
    gear = np.diag(TX40_RATIOS)
    gear[5, 4] = TX40_RATIOS[5]
    q = motors @ np.linalg.inv(gear).T + np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    tau, every, dt = torques @ gear, 25, 1 / 5000
    q = filtfilt(*butter(4, 100 * 2 * dt), q, axis=0)
    rows = np.arange(every, len(q) - every, every)
    means = np.stack([tau[k : k + every].mean(0) for k in rows])
    header = ["t", *(f"{x}_{j}" for x in ("q", "v", "tau") for j in TX40_JOINTS)]
    table = np.concatenate([rows[:, None] * dt, q[rows], np.gradient(q, dt, axis=0)[rows], means], 1)
    np.savetxt(out := folder / "joints.csv", table, delimiter=",", header=",".join(header), comments="")
    return out


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
        "BSD-3-Clause",
    ),
    "pendulum_bang_bang": Recorded(
        "simple_pendulum", (PENDULUM.format("energy_shaping"),), "data/urdf/dfki_simple_pendulum.urdf", "motor",
        "torque goes with the direction of motion throughout: friction, dead zone and mass cannot be told apart",
        "BSD-3-Clause",
    ),
    "pendulum_1kg": Recorded(
        "simple_pendulum", (PENDULUM.format("energy_shaping").replace(".csv", "_1kg.csv"),),
        "data/urdf/dfki_simple_pendulum.urdf", "motor",
        "a weight of 1 kg, where the URDF's link has 0.675 kg in all; torque goes with the direction of motion",
        "BSD-3-Clause",
    ),
    "ricmonk": Recorded(
        "ricmonk", tuple(f"results/singleBrachiation_tvlqr/TVLQR_{m}/measured.csv" for m in ("BF", "FB", "ZB", "ZF")),
        "data/simulation_models/finalRicMonkCurrent.urdf", "motor",
        "it lets go and catches a bar; motors with gears 6:1", "BSD-3-Clause", map=RICMONK_MAP,
    ),
    **{f"ricmonk_{grams}g": Recorded(
        "ricmonk", (f"results/multipleBrachiation_tvlqr/TVLQR_3xForward_{grams}gm_{how}Load/measured.csv",),
        "data/simulation_models/finalRicMonkCurrent.urdf", "motor",
        f"{how} load of {grams} g; it lets go and catches bars; motors with gears 6:1", "BSD-3-Clause", map=RICMONK_MAP,
    ) for grams, how in ((170, "asymmetric"), (200, "symmetric"))},
    "ur10": Recorded(
        "inverse_dynamics_solver", ("ur10_inverse_dynamics_solver/bagfiles/ur10_exciting_trajectory.db3",),
        "figaroh_examples:examples/ur10/urdf/ur10_robot.urdf", "motor", "", "BSD-3-Clause",
    ),
    "tx40": Recorded(
        "figaroh_examples", tuple(f"examples/staubli_TX40/data/{x}.csv" for x in ("pos_read_data", "curr_data")),
        "examples/staubli_TX40/urdf/tx40_mdh_modified.urdf", "motor",
        "published: damping 8.05 5.53 1.97 1.11 1.86 0.65, friction 7.14 8.26 6.34 2.48 3.03 0.28, rotor inertia 0.362 "
        "0.362 0.099 0.031 0.047 0.011; joints 5 and 6 are coupled",
        "Apache-2.0 (figaroh-plus, which it names)",
        map=TX40_MAP, prepare=tx40_table,
    ),
    "panda": Recorded(
        "inverse_dynamics_solver", ("franka_inria_inverse_dynamics_solver/bagfiles/panda_exciting_trajectory.db3",),
        "robosuite/robosuite/models/assets/robots/panda/robot.xml", None, "", "BSD-3-Clause",
    ),
}  # fmt: skip


def fetched(clones: Path, which: Recorded, folder: Path) -> tuple[list[Path], Path]:
    """The recordings and the model as files, those of a repository read out of its newest commit."""

    def taken(path: str, clone: Path = clones / which.clone) -> Path:
        out = folder / path.replace("/", "_")
        command = ["git", "-C", clone, "show", f"HEAD:{path}"]
        out.write_bytes(subprocess.run(command, check=True, capture_output=True).stdout)
        return out

    model, (other, _, path) = clones / which.model, which.model.partition(":")
    files = [taken(f) for f in which.files]
    if which.prepare is not None:
        files = [which.prepare(files, folder)]
    return files, model if model.is_file() else taken(path, clones / other) if path else taken(which.model)


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
        report = report_to / name if report_to is not None else Path(folder, "diagnosis")
        started = time.perf_counter()
        out = as_a_user(["--threads", str(threads), *known, "--data", str(recorded), "--out", str(report)])
        seconds = time.perf_counter() - started
        told = json.loads((report / "report.json").read_text())
    error = out.report["error"]
    found = [
        f"{e['effect']}({e['target']}) " + " ".join(f"{k}={p['estimate']:.4g}" for k, p in e["parameters"].items())
        for e in out.report["effects"]
    ]
    commit = ["git", "-C", clones / which.clone, "log", "-1", "--format=%h"]
    source = subprocess.run(commit, check=True, capture_output=True, text=True).stdout.strip()
    return {
        "set": name, "episodes": len(out.sim.data), "rows": sum(len(r.actions) for r in out.sim.data),
        "joints": out.sim.model.nv,
        "held_out": " ".join(map(str, error["held_out_episodes"])),
        "judged_by": "forces" if out.by_forces else "forecasts", "before": error["before"],
        "plain_fit": round(by_hand(out.context, out.state), 4), "pace": round(pace(out.context, out.state), 4),
        "sysid": by_sysid(out), "after": error["after"], "verdict": out.report["verdict"],
        "found": " + ".join(found),
        "faults": " + ".join(
            f"{f['fault']}({' '.join(f['targets'])})={f['estimate']}" for f in told["deployment_faults"]["faults"]
        ),
        "left_out": told.get("left_out", {}).get("share", 0), "known": which.known, "seconds": round(seconds, 1),
        "threads": threads, "licence": which.licence, "source": source, "commit": git_commit(),
    }  # fmt: skip


def as_a_user(options: list[str]) -> Diagnosis:
    """What ``idapt diagnose`` does with these options; it writes its report."""
    o = command_line().parse_args(options)
    o.mending = "--fix"
    return diagnose_recordings(o)


def by_sysid(out: Diagnosis) -> float | str:
    """Held-out error after mujoco.sysid; in words why there is none."""
    try:
        windows = out.state.windows.sensitivity.fit  # forecasts, where models are judged by forces too
        return round(sysid_fit(out.context, out.state, windows, out.sim.spec.copy(), "mujoco", 100).after, 4)
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        return f"failed: {' '.join(str(error).split())[:80]}"


def main() -> None:
    """Run the sets and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("clones", type=Path)
    p.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--report", type=Path, help="write each set's report below this folder")
    p.add_argument("--without", nargs="+", default=(), help="gates to leave out, see benchmarks/fewer_gates.py")
    p.add_argument("--out", type=Path, default=OUT)
    o = p.parse_args()
    if o.without and o.out == OUT:
        raise SystemExit(f"--without wants another --out than {OUT.name}, whose rows are of the diagnosis as it is")
    if not hasattr(sysid, "ParameterDict"):
        raise SystemExit('mujoco.sysid is not whole: pip install "idapt[benchmarks]"')
    rows = {r["set"]: r for r in read_rows(o.out)}
    for name in o.sets:
        if not (o.clones / SETS[name].clone).is_dir():
            print(f"{o.clones / SETS[name].clone} is not there: {name} is left out")
            continue
        with judged_by(o.without):
            rows[name] = run(name, o.clones, o.threads, o.report)
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
        print({k: rows[name][k] for k in FIELDS[:12]}, flush=True)


if __name__ == "__main__":
    main()

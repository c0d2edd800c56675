r"""Which velocities are near the truth: a sensor's own, slopes of its positions, or those learned from simulations?

    python benchmarks/discovery.py --config cheetah_quick --seeds 0 --steps 4000 --cases "armature 0.4"   # records
    python benchmarks/velocities.py --config cheetah_quick --seeds 0 --recordings control "armature_0.4_hard"

For the control (source images as G shows them) and for recordings of targets, each joint's errors are in units of the
speeds' spread (1 is as far off as their mean is), with what the truth is over what is read, by least squares. True
states are compared, for evaluation only. Writes results/velocities.csv.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
from tables import replace_rows

from cli.provenance import git_commit
from cli.run_folder import load_estimator, load_visual, open_run
from datamodules import Trajectories
from datamodules.unpaired import read_all
from idapt_pl.diagnosis.data import slopes
from idapt_pl.sensing import Sensor, readable, typical_errors
from idapt_pl.velocities import learn_velocities

KEY = ("config", "seed", "recording", "joint")


def with_states(sensor: Sensor, path: Path, G) -> Trajectories:
    """What a sensor read of a recording, and the true states."""
    read, known = sensor.read([path], G), read_all([path], also="state")
    both = zip(read, known, strict=True)
    return replace(
        read,
        episodes=tuple(replace(e, observations=e.observations | {"state": t.observations["state"]}) for e, t in both),
    )


def compared(truth: np.ndarray, read: np.ndarray) -> tuple[float, float]:
    """Root mean square error in units of the truth's spread, and the truth over what is read; of one joint, (n,)."""
    about = read - read.mean()
    error = np.sqrt(np.square(read - truth).mean()) / truth.std()
    return round(float(error), 3), round(float((about * (truth - truth.mean())).sum() / np.square(about).sum()), 3)


def main() -> None:
    """Every recording of every sensor."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="cheetah_quick", help="name in the table, and of the runs")
    p.add_argument("--seeds", type=int, nargs="+", default=[0])
    p.add_argument("--runs", help="folders of runs, less _<seed>; default runs/sensor_<config>")
    p.add_argument("--recordings", nargs="+", default=("control", "armature_0.4_hard"))
    p.add_argument("--out", type=Path, default=ROOT / "results/velocities.csv")
    o, commit = p.parse_args(), git_commit()
    for seed in o.seeds:
        folder = Path(f"{o.runs or ROOT / f'runs/sensor_{o.config}'}_{seed}")
        run = open_run(folder)
        task, G = run.worlds.task, load_visual(run)
        source = task.domain("source")
        model, sensor = source.compile(), Sensor(load_estimator(run), task, run.worlds.frame_stack)
        control = with_states(sensor, folder / "hidden/control.h5", G)
        noise = typical_errors(task, model, readable(task, model, control, control))
        for name in o.recordings:
            given = control if name == "control" else with_states(sensor, folder / f"hidden/{name}.h5", None)
            read = readable(task, model, given, control)
            reader = learn_velocities(task, source, [e.actions for x in (given, control) for e in x], noise, seed)
            seen = [e.observations for e in read]
            truth = np.concatenate([task.motion(np.asarray(s["state"], float), read.dt)[1] for s in seen])
            ways = {
                "sensor": np.concatenate([s["qvel"] for s in seen]),
                "slopes": np.concatenate([slopes(model, read.dt * np.arange(len(s["qpos"])), s["qpos"]) for s in seen]),
                "simulations": np.concatenate([reader.read(e.observations["qpos"], e.actions) for e in read]),
            }
            rows = []
            for i, joint in ((i, model.joint(j).name) for i, j in enumerate(model.dof_jntid)):
                row = {"config": o.config, "seed": seed, "recording": name, "joint": joint}
                row["spread"] = round(float(truth[:, i].std()), 3)
                if joint not in task.unseen:
                    for way, v in ways.items():
                        row[f"{way}_error"], row[f"{way}_gain"] = compared(truth[:, i], v[:, i])
                    rows.append(row | {"commit": commit})
            print(*rows, sep="\n", flush=True)
            replace_rows(o.out, rows, KEY)


if __name__ == "__main__":
    main()

r"""How do the sensors of benchmarks/discovery.py misread its recordings? Evaluation only: true states are compared.

    python benchmarks/discovery.py --seeds 0 1 2 3 4     # makes sensors and recordings
    python benchmarks/sensor_errors.py --seeds 0 1 2 3 4
    python benchmarks/sensor_errors.py --config "cheetah_quick easy" --runs runs/sensor_cheetah_quick_easy --seeds 0 \
        --recordings control nothing_easy

For the control (source images as G shows them, to which the sensor is calibrated) and for recordings of targets, each
position's error is split by least squares into bias, gain (what is read over what is), lag and the rest. Frames further
off than six robust spreads are left out and counted. Writes results/sensor_errors.csv.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import mujoco
import numpy as np
from tables import replace_rows

from idapt_pl.run import Run
from datamodules.unpaired import read_all
from idapt_pl.prediction.data import position_difference
from idapt_pl.image_diagnosis.sensor import ImageSensor

KEY = ("config", "seed", "recording", "joint")
FAR = 6.0
RECORDINGS = (
    "control", "nothing_hard", "pole_200_kg_hard", "pole_50_kg_hard", "hinge_damping_hard", "action_delay_hard",
)  # fmt: skip


def errors(sensor: ImageSensor, model: mujoco.MjModel, path: Path, G) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is read less what is, positions and velocities, (n, nv) each."""
    readings, parts = sensor.read([path], G), []
    for truth, read in zip(read_all([path], also="state"), readings, strict=True):
        qpos, qvel = sensor.task.motion(np.asarray(truth.observations["state"], float), readings.dt)
        parts.append((position_difference(model, qpos, read.observations["qpos"]), qpos, qvel))
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def split(error: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> dict[str, float]:
    """Bias, gain, lag and what is left of one position's errors, (n,)."""
    off = np.abs(error - np.median(error))
    near = off < FAR * 1.48 * np.median(off)
    centred = position[near] - position[near].mean()
    terms = np.stack([np.ones(near.sum()), centred, velocity[near]], 1)
    (bias, gain, lag), *_ = np.linalg.lstsq(terms, error[near], rcond=None)
    left = (error[near] - terms @ (bias, gain, lag)).std()
    found = {"bias": bias, "gain": 1 + gain, "lag": -lag, "left": left, "spread": position[near].std()}
    return {k: round(float(v), 5) for k, v in found.items()} | {"left_out": round(1 - float(near.mean()), 4)}


def main() -> None:
    """Read every recording of every sensor."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="pendulum_quick", help="name in the table, and of the runs")
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--runs", help="folders of runs, less _<seed>; default runs/sensor_<config>")
    p.add_argument("--recordings", nargs="+", default=RECORDINGS)
    p.add_argument("--out", type=Path, default=ROOT / "results/sensor_errors.csv")
    o = p.parse_args()
    for seed in o.seeds:
        folder = Path(f"{o.runs or ROOT / f'runs/sensor_{o.config}'}_{seed}")
        run = Run.open(folder)
        task, G = run.worlds.task, run.load_visual()
        sensor, model = ImageSensor(run.load_estimator(), task, run.worlds.frame_stack), task.domain("source").compile()
        for name in o.recordings:
            found = errors(sensor, model, folder / "hidden" / f"{name}.h5", G if name == "control" else None)
            about = {"config": o.config, "seed": seed, "recording": name}
            joints = [(i, model.joint(i).name) for i in range(model.nv) if model.joint(i).name not in task.unseen]
            rows = [about | {"joint": joint} | split(*(x[:, i] for x in found)) for i, joint in joints]
            print(*rows, sep="\n", flush=True)
            replace_rows(o.out, rows, KEY)


if __name__ == "__main__":
    main()

"""Two published models of one robot: what does `idapt diagnose` say that one of them has and the other has not?

    python benchmarks/two_models.py --seeds 0 1 2          # finished rows are kept

Gymnasium's half cheetah is the nominal model; dm_control's, under random commands, is what is recorded. Nobody hid
anything: what differs is in the two files. dm_control's front thigh ends at 0.4 degrees in place of 40, and its motor
has three quarters of the torque; its rear foot folds, as far as -230 degrees; its floor has a friction of 1 in place of
0.4. It also has harder stops and contacts, and limbs that touch each other, which are no effects here.
Writes results/two_models.csv, one row a seed and effect that was found or that there is.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import gymnasium
import numpy as np
from dm_control import suite
from tables import read_rows, write_rows

from cli.provenance import cpu_model, git_commit
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.model import read_model

FIELDS = (
    "seed", "effect", "target", "parameter", "nominal", "estimate", "low", "high", "truth", "before", "after",
    "verdict", "seconds", "threads", "commit", "cpu",
)  # fmt: skip
MODEL = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "half_cheetah.xml"
EPISODES, STEPS, PERIOD, HELD = 40, 80, 0.02, 4
NOISE_Q, NOISE_V = 5e-4, 5e-3

TRUTH = {
    ("joint_range", "fthigh", "upper"): np.deg2rad(0.4),
    ("joint_range", "bfoot", "lower"): np.deg2rad(-230),
    ("contact_friction", "floor", "sliding"): 1.0,
    ("actuator_gain", "fthigh", "gain"): 0.75,
}
"""What differs, in the vocabulary of a diagnosis, as it stands in dm_control's file."""


def record(seed: int) -> Trajectories:
    """dm_control's cheetah from its own starts, under random torques that are held for four control steps."""
    rng, made = np.random.default_rng(seed), []
    env = suite.load("cheetah", "run", task_kwargs={"random": seed})
    physics = env.physics
    for _ in range(EPISODES):
        env.reset()
        actions = np.repeat(rng.uniform(-1, 1, (STEPS // HELD, 6)), HELD, 0)
        q, v = [physics.data.qpos.copy()], [physics.data.qvel.copy()]
        for action in actions:
            physics.set_control(action)
            physics.step(round(PERIOD / physics.timestep()))
            q.append(physics.data.qpos.copy()), v.append(physics.data.qvel.copy())
        qpos = np.array(q) + NOISE_Q * rng.standard_normal((STEPS + 1, 9))
        qvel = np.array(v) + NOISE_V * rng.standard_normal((STEPS + 1, 9))
        made.append(Episode(actions.astype(np.float32), {"qpos": qpos, "qvel": qvel}))
    return Trajectories(tuple(made), PERIOD)


def run(seed: int, threads: int) -> list[dict]:
    """Record, diagnose, and compare with what stands in the files."""
    data, started = record(seed), time.perf_counter()
    report = diagnose(read_model(MODEL), data, seed=seed, threads=threads, laws=False).report
    every = {
        "seed": seed, "verdict": report["verdict"], "before": report["error"]["before"],
        "after": report["error"]["after"], "seconds": round(time.perf_counter() - started, 1), "threads": threads,
        "commit": git_commit(), "cpu": cpu_model(),
    }  # fmt: skip
    found = {
        (e["effect"], e["target"], name): p for e in report["effects"] for name, p in e["parameters"].items()
    }  # fmt: skip
    rows = []
    for key in dict.fromkeys([*found, *TRUTH]):
        p = found.get(key, {})
        low, high = p.get("ci95") or ("", "")
        told = {"nominal": p.get("nominal", ""), "estimate": p.get("estimate", ""), "low": low, "high": high}
        truth = round(float(TRUTH[key]), 5) if key in TRUTH else ""
        rows.append(every | dict(zip(("effect", "target", "parameter"), key, strict=True)) | told | {"truth": truth})
    return rows


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--threads", type=int, default=1)
    p.add_argument("--out", type=Path, default=ROOT / "results" / "two_models.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    for seed in o.seeds:
        if str(seed) not in {r["seed"] for r in rows}:
            rows += run(seed, o.threads)
            write_rows(o.out, rows, FIELDS)
            print(*(f"{r['effect']}({r['target']}) {r['estimate']}" for r in rows if r["seed"] == seed), sep="\n")


if __name__ == "__main__":
    main()

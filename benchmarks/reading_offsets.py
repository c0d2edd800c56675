"""What does a policy's encoder read too much of every position in the target, and what do forecasts say of it?

    python benchmarks/reading_offsets.py --runs runs/walker2d_hard_9 --steps 0 1

The policy acts in the target for some steps. The median of what is read too much there, by true states, stands beside
the offset that :mod:`idapt_pl.smoothing.offsets` finds from readings and actions alone; and the same of the source's
own recordings as G shows them, where there is none. All in units of the states' spread. Evaluation only: the target's
states are looked at. Writes results/reading_offsets.csv.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
import torch

from benchmarks.tables import replace_rows
from cli.provenance import git_commit
from datamodules.trajectories import Trajectories
from datamodules.unpaired import read_all
from idapt_pl.rl.collect import collect
from idapt_pl.rl.policy import deterministic
from idapt_pl.run import Run
from idapt_pl.run_folder.results import newest_of
from idapt_pl.smoothing import ReadRecording, reading_offsets
from idapt_pl.stages.labels import recordings_of
from idapt_pl.stages.refinement import position_components

FIELDS = ("run", "step", "data", "component", "true", "found", "gain", "standard_error", "readings", "commit")
CONTROLS = 16
"""Recordings of the source that are looked at."""


def median_offset(
    recordings: Sequence[ReadRecording], states: Sequence[np.ndarray], scale: np.ndarray, begin: int
) -> np.ndarray:
    """What is read too much, (s,), after the first control steps."""
    late = [(r.readings[begin:] - s[begin:]) / scale for r, s in zip(recordings, states, strict=True)]
    return np.median(np.concatenate(late), 0)


def rows_of(run: Run, step: int, steps: int, seed: int) -> list[dict]:
    """Rows of one step of a run, in the target and in the control."""
    folder, worlds = run.context.stages.run_dir / f"step_{step:02d}", run.context.worlds
    policy = run.load_policy(folder / "policy/final.ckpt")
    sensor = policy.estimator(run.load_visual(newest_of(folder, "visual/final.ckpt")))
    begin = run.config.schedule.paired_steps
    known = read_all([newest_of(folder, "translated.h5")], also="state")
    scale = np.concatenate([e.observations["state"] for e in known]).std(0) + 1e-9
    with closing(worlds.rewarded_target(1)) as env:
        there = collect(env, deterministic(policy), steps, seed, "evaluation only")
    control = replace(known, episodes=tuple(e for e in known if len(e) > 2 * begin)[-CONTROLS:])

    def rows(data: Trajectories, name: str) -> list[dict]:
        states = [e.observations["state"] for e in data]
        recordings = recordings_of(data, sensor, worlds.frame_stack)
        true = median_offset(recordings, states, scale, begin)
        found, (gain, error) = reading_offsets(worlds.task, worlds.source_domain, recordings, scale, begin)
        same = {"run": run.context.stages.run_dir.name, "step": step, "data": name, "readings": sum(map(len, states))}
        same |= {"gain": round(gain, 4), "standard_error": round(error, 4), "commit": git_commit()}
        shown = position_components(worlds.task, states[0][0].astype(float))
        return [
            same | {"component": i, "true": round(float(true[i]), 3), "found": round(float(found[i] / scale[i]), 3)}
            for i in shown
        ]

    return rows(there, "target") + rows(control, "control")


def main() -> None:
    """Measure every run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs whose target is a domain")
    p.add_argument("--steps", type=int, nargs="+", default=[0])
    p.add_argument("--length", type=int, default=1200, help="control steps of the policy in the target")
    p.add_argument("--seed", type=int, default=7, help="of resets")
    p.add_argument("--out", type=Path, default=ROOT / "results/reading_offsets.csv")
    o = p.parse_args()
    torch.set_num_threads(1)
    for folder in o.runs:
        run = Run.open(folder)
        for step in o.steps:
            rows = rows_of(run, step, o.length, o.seed)
            replace_rows(o.out, rows, ("run", "step", "data"), FIELDS)
            for row in rows:
                print(row)


if __name__ == "__main__":
    main()

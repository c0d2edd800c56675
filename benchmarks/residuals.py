r"""Does F bring the source nearer to how the target moves? By images and actions, of finished runs, rollout by rollout.

    python benchmarks/residuals.py runs/benchmark_walker_quick_IDAPT_0 runs/benchmark_cheetah_quick_no_effects_0

What evaluation.json says of step 1 (:mod:`idapt_pl.rl.transition_distance`), with more rollouts: energy distances
without and with F, the same draws with both, and their difference. Each rollout is as long as the target's recording. A
run's policy before step 1, its G and F of step 1 are used; no target is simulated. Writes results/residuals.csv.
"""

from __future__ import annotations

import argparse
import copy
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
from tables import replace_rows

from cli.provenance import git_commit
from idapt_pl.run import Run
from idapt_pl.rl.transition_distance import transition_distances
from idapt_pl.stage import load_finished

KEY = ("run", "seed")


def measure(folder: Path, rollouts: int) -> dict:
    """Of one run's step 1."""
    run = Run.open(folder)
    make, worlds, G, step = run.context.make, run.worlds, run.load_visual(), folder / "step_01"
    policy = run.load_policy(folder / "step_00/policy/final.ckpt")
    if (step / "estimator/final.ckpt").exists():  # it was refined for this G
        refined = load_finished(make.state_predictor(**worlds.dimensions), step / "estimator/final.ckpt")
        policy.actor.encoder.load_state_dict(refined.P_S.state_dict())
    F = load_finished(
        make.dynamics(encoder=copy.deepcopy(policy.actor.encoder), **worlds.action_bounds), step / "dynamics/final.ckpt"
    )
    without, with_F, floor = transition_distances(worlds, policy, G, F, [step / "target.h5"], 0, rollouts)
    found, by = {"noise_floor": floor}, with_F - without
    for name, far in {"without_F": without, "with_F": with_F}.items():
        found |= {
            name: far.mean(),
            f"{name}_std": far.std(ddof=1),
            f"{name}_least": far.min(),
            f"{name}_most": far.max(),
        }
    found |= {"difference": by.mean(), "standard_error": by.std(ddof=1) / np.sqrt(rollouts)}
    return {k: round(float(v), 3) for k, v in found.items()}


def main() -> None:
    """Every run given."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("runs", nargs="+", type=Path, help="folders of finished runs with a grounding step")
    p.add_argument("--rollouts", type=int, default=8, help="with F and without")
    p.add_argument("--out", type=Path, default=ROOT / "results/residuals.csv")
    o, commit = p.parse_args(), git_commit()
    for folder in o.runs:
        name, seed = folder.name.removeprefix("benchmark_").rsplit("_", 1)
        row = {"run": name, "seed": seed, "rollouts": o.rollouts, **measure(folder, o.rollouts), "commit": commit}
        print(row, flush=True)
        replace_rows(o.out, [row], KEY)


if __name__ == "__main__":
    main()

"""What does a teacher lose in a walker that is heavier than it was told, with and without randomised masses?

    python benchmarks/randomised_teachers.py --seeds 0 --found 6.2 --interval 4.2 9.2

Two teachers of Walker2d learn on states of the source with another mass of the torso: one with ``--found``, the other
with 32 masses drawn uniformly from ``--interval``, as ``randomisation.ranges: found`` does. Each is measured with the
masses of ``--at``, on true states and on states with slow noise of the size that it learned with (``noisy``). Writes
results/randomised_teachers.csv, a row for each teacher and mass; 100,000 steps take about ten minutes.
"""

from __future__ import annotations

import argparse
import sys
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
from idapt_pl.effects import Domain
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules.state_policy import StateSAC
from idapt_pl.rl.experts import fit_expert, measure_expert
from idapt_pl.rl.noisy_teacher import noisy_return
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import make_task

KEY = ("masses", "seed", "steps", "at")
NOISE, VARIANTS, EPISODES = 0.15, 32, 20


def weighing(mass: float) -> Domain:
    """The source with another torso [kg]."""
    return make_task("walker2d").domain("source").with_effects(BodyMass("torso", mass))


def learned(masses: list[float], seed: int, steps: int, folder: Path) -> StateSAC:
    """A teacher that learned with one mass, or with masses between two."""
    task, (low, high) = make_task("walker2d"), (masses[0], masses[-1])
    drawn = np.random.default_rng(seed).uniform(low, high, VARIANTS) if high > low else ()
    recipe = replace(task.expert, steps=steps)
    env = VectorStateEnv(task, weighing((low + high) / 2), recipe.num_envs, tuple(weighing(m) for m in drawn))
    bounds = [b.tolist() for b in (env.single_action_space.low, env.single_action_space.high)]

    def build() -> StateSAC:
        return StateSAC(env.state_dim, *bounds, gamma=recipe.gamma, noise=NOISE)

    with closing(env):
        return fit_expert(build, lambda device: env, recipe, Stages(folder, seed, cpu_trainer), 0, "teacher")


def main() -> None:
    """Train and measure."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0])
    p.add_argument("--found", type=float, default=6.2, help="kg")
    p.add_argument("--interval", type=float, nargs=2, default=[4.2, 9.2], help="kg")
    p.add_argument("--at", type=float, nargs="+", default=[4.5, 6.2, 7.5, 8.6, 10.0, 11.5], help="kg")
    p.add_argument("--steps", type=int, default=100_000)
    p.add_argument("--folder", type=Path, default=ROOT / "runs/randomised_teachers")
    p.add_argument("--out", type=Path, default=ROOT / "results/randomised_teachers.csv")
    o = p.parse_args()
    torch.set_num_threads(1)
    task = make_task("walker2d")
    for seed in o.seeds:
        for masses in ([o.found], o.interval):
            name = " to ".join(map(str, masses))
            policy = learned(masses, seed, o.steps, o.folder / f"{name.replace(' ', '_')}_{seed}")
            for at in o.at:
                clean = measure_expert(policy, task, weighing(at), EPISODES, 1000)
                with closing(VectorStateEnv(task, weighing(at), EPISODES)) as env:
                    noisy = noisy_return(policy, env, EPISODES, 7)
                row = {"masses": name, "seed": seed, "steps": o.steps, "at": at, "mean": round(clean.mean, 1)}
                row |= {"std": round(clean.std, 1), "noisy": round(noisy, 1), "commit": git_commit()}
                replace_rows(o.out, [row], KEY)
                print(*row.values(), flush=True)


if __name__ == "__main__":
    main()

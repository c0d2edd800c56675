"""How often does a teacher of Sawyer-Push reach the goal, and how often when hand, puck and goal are read elsewhere?

    python benchmarks/misled_pushes.py --seeds 102 --steps 16000 32000 --noise 0 0.2

A teacher is trained on the source's true states, for so many steps and with so much noise on what its actor sees
(``teacher.noise`` and ``teacher.offset``, both alike). Then it plays source and hard target, on true states and with
hand, puck and goal each read off by a distance that is drawn once an episode, normal along x and y: what a
transformation that draws them elsewhere does. No image takes part, and nothing is chosen in the target. Writes
results/misled_pushes.csv, a row a teacher: shares of 100 episodes; 32,000 steps take two minutes.
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
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules.state_policy import StateSAC
from idapt_pl.rl.experts import fit_expert
from idapt_pl.rl.returns import evaluate
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import Task, make_task

KEY = ("steps", "noise", "seed")
EPISODES = 100
HAND, PUCK, GOAL, PUCK_TO_HAND, GOAL_TO_PUCK = (slice(i, i + 2) for i in (18, 28, 25, 35, 38))
"""Of x and y in the state of :class:`idapt_pl.tasks.SawyerPush`."""


def trained(task: Task, steps: int, noise: float, seed: int, folder: Path) -> StateSAC:
    """A teacher of the source; one that is in the folder is loaded instead."""
    recipe = replace(task.expert, steps=steps)
    with closing(VectorStateEnv(task, task.domain("source"), recipe.num_envs)) as env:
        bounds = [b.tolist() for b in (env.single_action_space.low, env.single_action_space.high)]

        def build() -> StateSAC:
            return StateSAC(env.state_dim, *bounds, gamma=recipe.gamma, actor_every=2, noise=noise, offset=noise)

        return fit_expert(build, lambda device: env, recipe, Stages(folder, seed, cpu_trainer), 0, "teacher")


def misread(states: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """States (n, 40) with hand, puck and goal displaced by errors (n, 3, 2) [m], and what lies between them too."""
    seen = states.copy()
    hand, puck, goal = errors.transpose(1, 0, 2)
    for part, error in (
        (HAND, hand), (PUCK, puck), (GOAL, goal), (PUCK_TO_HAND, hand - puck), (GOAL_TO_PUCK, puck - goal)
    ):  # fmt: skip
        seen[:, part] += error
    return seen


def reached(task: Task, domain: Domain, teacher: StateSAC, spread: float) -> float:
    """Share of episodes in which it reaches the goal, with errors of that spread [m]."""
    errors = spread * np.random.default_rng(1).standard_normal((EPISODES, 3, 2))
    with closing(VectorStateEnv(task, domain, EPISODES)) as env:  # all at once, each with its own error
        act = lambda states: teacher.act(misread(states, errors), deterministic=True)  # noqa: E731
        return evaluate(env, act, EPISODES, 1000).mean


def main() -> None:
    """Train and measure."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[102])
    p.add_argument("--steps", type=int, nargs="+", default=[16_000, 32_000])
    p.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.2], help="in units of the states' spread")
    p.add_argument("--folder", type=Path, default=ROOT / "runs/misled_pushes")
    p.add_argument("--out", type=Path, default=ROOT / "results/misled_pushes.csv")
    o = p.parse_args()
    torch.set_num_threads(1)
    task = make_task("sawyer_push")
    for seed, steps, noise in ((s, n, e) for s in o.seeds for n in o.steps for e in o.noise):
        teacher = trained(task, steps, noise, seed, o.folder / f"{steps}_{noise:g}_{seed}")
        row = {"steps": steps, "noise": noise, "seed": seed}
        for name in ("source", "hard"):
            for cm in (0, 1, 2):
                row[f"{name}_{cm}_cm"] = round(reached(task, task.domain(name), teacher, cm / 100), 2)
        row |= {"commit": git_commit()}
        replace_rows(o.out, [row], KEY)
        print(*row.values(), flush=True)


if __name__ == "__main__":
    main()

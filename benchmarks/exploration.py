"""What do exploration policies show of a task, before there is a policy for the target?

    python benchmarks/exploration.py --runs runs/walker2d_hard_0 runs/half_cheetah_hard_0
    python benchmarks/exploration.py --runs runs/sawyer_push_hard_0 --steps 2000

Plays ``random``, ``babble`` and ``rehearse`` (with the teacher of the run) in the run's source and target, on states,
and writes ``results/exploration.csv``: the length of episodes in control steps, and how far positions move within
them, the standard deviation over an episode, averaged over episodes and over the joints that are driven. Beside them
stand two references: the run's teacher where it looks, ``closed loop``, and actions of zero, ``nothing``. ``return`` is
what the task would have paid; it is for these two.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from rendering import write_table

import idapt_pl  # noqa: F401  sets the GL backend before MuJoCo is loaded
from idapt_pl.envs import VectorStateEnv
from idapt_pl.rl.exploration import EXPLORATION, OpenLoopReplay
from idapt_pl.rl.policy import Policy, tick
from idapt_pl.run import Run
from idapt_pl.stages.collection import source_teacher


def explorers(run: Run, seed: int) -> dict[str, Callable[[VectorStateEnv], Policy]]:
    """By name, given the environment that is acted in."""
    teacher = source_teacher(run.context)
    task = run.worlds.task
    rehearse = lambda env: OpenLoopReplay(teacher, VectorStateEnv(task, task.domain("source"), 1), seed)  # noqa: E731
    by_name = {name: lambda env, make=make: make(env, seed) for name, make in EXPLORATION.items()}
    nothing = lambda env: lambda states: np.zeros_like(env.action_space.low)  # noqa: E731
    return by_name | {"rehearse": rehearse, "closed loop": lambda env: teacher.act, "nothing": nothing}


def play(env: VectorStateEnv, act: Policy, steps: int, seed: int) -> tuple[list[int], list[float], list[np.ndarray]]:
    """Of whole episodes: lengths, returns, and the spread of the driven joints' positions."""
    driven = [int(env.model.jnt_qposadr[j]) for j in env.model.actuator_trnid[:, 0]]
    obs, _ = env.reset(seed=seed + 1)  # not where the rehearsal starts
    lengths, returns, spreads, seen, paid = [], [], [], [], 0.0
    for _ in range(steps):
        seen.append(env.data[0].qpos[driven].copy())
        obs, rewards, terminations, truncations, _ = env.step(act(obs["pixels"]))
        paid += float(rewards[0])
        tick(act, terminations | truncations)
        if terminations[0] or truncations[0]:
            lengths.append(len(seen))
            returns.append(paid)
            spreads.append(np.std(seen, axis=0))
            seen, paid = [], 0.0
    return lengths, returns, spreads


def measure(folder: Path, steps: int, seed: int) -> list[dict]:
    """The rows of one run."""
    run, rows = Run.open(folder), []
    worlds = run.worlds
    for domain in (worlds.task.domain("source"), worlds.target_domain):
        for name, make in explorers(run, seed).items():
            torch.manual_seed(seed)
            with closing(VectorStateEnv(worlds.task, domain, 1)) as env:
                lengths, returns, spreads = play(env, make(env), steps, seed)
            row = {"task": worlds.task.name, "domain": domain.name, "exploration": name, "episodes": len(lengths)}
            row |= {"length": round(np.mean(lengths), 1), "median_length": round(np.median(lengths), 1)}
            row |= {"return": round(np.mean(returns), 1), "return_std": round(np.std(returns), 1)}
            rows.append(row | {"spread": round(float(np.mean(spreads)), 3)})
    return rows


def main() -> None:
    """Measure."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs with a teacher")
    p.add_argument("--steps", type=int, default=10_000, help="control steps in each domain, by each policy")
    p.add_argument("--seed", type=int, default=0)
    o = p.parse_args()
    write_table("exploration", [row for run in o.runs for row in measure(run, o.steps, o.seed)], key=("task",))


if __name__ == "__main__":
    main()

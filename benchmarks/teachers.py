"""Is it dynamics or seeing that a transferred policy lacks? A run's teachers, which see states, and its policies.

    python benchmarks/teachers.py --runs runs/benchmark_cheetah_quick_IDAPT_0 runs/benchmark_cheetah_quick_IDAPT_1

A teacher that does as well in the target as in the source, with the effects that the run found there, has nothing to
learn of dynamics; what its student, the policy that sees images, does worse in the target than in the grounded source
is then lost in seeing. Evaluation only: the target's states are looked at. Writes results/teachers.csv, a row a
teacher: ``plain`` is the source as it was given, ``source`` as it was repaired; ``policy_grounded`` and
``policy_target`` are of the run's evaluation.json.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
from tables import replace_rows

from cli.provenance import git_commit
from idapt_pl.run import Run
from idapt_pl.stages.collection import source_teacher
from idapt_pl.effects import Domain
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules.state_policy import StateSAC
from idapt_pl.stage import load_finished
from idapt_pl.tasks import Task

KEY = ("run", "teacher")
FIELDS = (
    "run", "teacher", "episodes", "plain", "plain_std", "source", "source_std", "target", "target_std",
    "policy_grounded", "policy_target", "commit",
)  # fmt: skip
TEACHER = re.compile(r"(source_|hardened_)?teacher(_\d+)?")
"""Stages that end with a teacher; those of encoders and filters are named after it, too."""


def returns(task: Task, teacher: StateSAC, domain: Domain, episodes: int, seed: int) -> np.ndarray:
    """Of one episode each in simulations side by side, (episodes,)."""
    total, running = np.zeros(episodes), np.ones(episodes, bool)
    with closing(VectorStateEnv(task, domain, episodes)) as env:
        obs, _ = env.reset(seed=seed)
        while running.any():
            obs, reward, terminations, truncations, _ = env.step(teacher.act(obs["state"]))
            total += reward * running
            running &= ~(terminations | truncations)
    return total


def measure(folder: Path, episodes: int, seed: int) -> list[dict]:
    """A row for each teacher of a run."""
    run = Run.open(folder)
    worlds, teacher, table = run.worlds, source_teacher(run.context), []
    paths = (p for p in folder.glob("step_*/*/final.ckpt") if TEACHER.fullmatch(p.parent.name))
    for path in sorted(paths):
        load_finished(teacher, path)
        row = {"run": folder.name, "teacher": str(path.parent.relative_to(folder)), "episodes": episodes}
        domains = {"plain": worlds.first_source, "source": worlds.source_domain, "target": worlds.target_domain}
        for name, domain in domains.items():
            found = returns(worlds.task, teacher, domain, episodes, seed)
            row |= {name: round(float(found.mean()), 1), f"{name}_std": round(float(found.std()), 1)}
        evaluation = path.parents[1] / "evaluation.json"
        last = "hardened_teacher" if (path.parents[1] / "hardened_teacher/final.ckpt").exists() else "teacher"
        taught = path.parent.name == last and evaluation.exists()
        result = json.loads(evaluation.read_text()) if taught else {}
        for k in ("grounded", "target"):
            row[f"policy_{k}"] = round(result[k]["mean"], 1) if taught else ""
        table.append(row | {"commit": git_commit()})
    return table


def main() -> None:
    """Measure every run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs with a teacher")
    p.add_argument("--episodes", type=int, default=20)
    p.add_argument("--seed", type=int, default=0, help="of resets")
    p.add_argument("--out", type=Path, default=ROOT / "results/teachers.csv")
    o = p.parse_args()
    for run in o.runs:
        rows = measure(run, o.episodes, o.seed)
        print(*rows, sep="\n", flush=True)
        replace_rows(o.out, rows, KEY, FIELDS)


if __name__ == "__main__":
    main()

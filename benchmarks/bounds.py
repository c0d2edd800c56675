"""Is each gap real, and can it be closed? Policies on states: the source's in every domain, and oracles.

    python benchmarks/bounds.py --task inverted_pendulum half_cheetah --seeds 0 1 2

For every task and seed one policy is trained in the source and evaluated in source, easy and hard (direct
transfer), and one is trained in each target (the oracle). These policies see the true state, so the visual gap plays
no part: what falls is due to dynamics alone. ``mean`` and ``std`` are of the task's metric, ``return`` is the mean
return, which falls where success does not. Rows are added to results/bounds.csv; rows of the same task, seed,
domain and policy are replaced. Trained policies are kept below runs/bounds and not trained again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported

# isort: split
import numpy as np
from tables import read_rows, replace_rows

from cli.provenance import cpu_model, git_commit
from idapt_pl.rl.experts import measure_expert, train_expert
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import TASKS, Task, make_task
from idapt_pl.tasks.recipe import ExpertRecipe

ROOT = Path(__file__).parents[1]
DOMAINS = ("source", "easy", "hard")
KEY = ("task", "domain", "policy", "seed")


def rows(task: Task, seed: int, recipe: ExpertRecipe, episodes: int, homes: list[str]) -> Iterator[list[dict]]:
    """The bounds of one task and seed, those of one policy at a time; ``homes`` are the domains to train in."""
    stages = Stages(ROOT / f"runs/bounds/{task.name}_{seed}_{recipe.steps}", seed, cpu_trainer)
    for trained_in in homes:
        policy = train_expert(task, task.domain(trained_in), recipe, stages, trained_in)
        found = []
        minutes = json.loads((stages.folder(0) / trained_in / "stage.json").read_text())["wall_s"] / 60
        for domain in DOMAINS if trained_in == "source" else (trained_in,):
            result = measure_expert(policy, task, task.domain(domain), episodes, seed=1000 + seed)
            kind = "oracle" if trained_in == domain else "direct transfer"
            row = {"task": task.name, "domain": domain, "policy": kind, "seed": seed, "metric": task.metric}
            row |= {"mean": round(result.mean, 3), "std": round(result.std, 3), "episodes": episodes}
            row |= {"return": round(float(np.mean(result.returns)), 3)}
            found.append(row | {"steps": recipe.steps, "minutes": round(minutes, 1)})
            print(*row.values(), flush=True)
        yield found


def summarise(table: list[dict]) -> str:
    """Mean and spread over seeds of every policy's metric, a line each."""
    groups: dict[tuple[str, ...], list[float]] = {}
    for row in table:
        groups.setdefault((row["task"], row["domain"], row["policy"], row["metric"]), []).append(float(row["mean"]))

    def figure(values: list[float]) -> str:
        if len(values) == 1:
            return f"{values[0]:.4g} (1 seed)"
        return f"{np.mean(values):.4g} ± {np.std(values, ddof=1):.4g} ({len(values)} seeds)"

    lines = ((*names, figure(values)) for names, values in groups.items())
    return "\n".join(
        f"{task:18s} {domain:7s} {policy:16s} {metric} {told}" for task, domain, policy, metric, told in lines
    )


def main() -> None:
    """Measure the bounds."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--task", choices=TASKS, nargs="+", default=list(TASKS))
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--trained-in", choices=DOMAINS, nargs="+", default=DOMAINS, help="which policies")
    p.add_argument("--steps", type=int, help="environment steps of every policy; default the task's recipe")
    p.add_argument("--episodes", type=int, default=20)
    p.add_argument("--out", type=Path, default=ROOT / "results/bounds.csv")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    o = p.parse_args()
    for name in o.task if not o.summary else ():
        recipe = dataclasses.replace(TASKS[name].expert, **({"steps": o.steps} if o.steps else {}))
        for seed in o.seeds:
            for new in rows(make_task(name), seed, recipe, o.episodes, o.trained_in):
                replace_rows(o.out, [row | {"commit": git_commit(), "cpu": cpu_model()} for row in new], KEY)
    print(summarise(read_rows(o.out)))


if __name__ == "__main__":
    main()

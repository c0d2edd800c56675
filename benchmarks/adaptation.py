"""How long must a teacher adapt when the dynamics have changed? Found in the source alone, changed at random.

    python benchmarks/adaptation.py --config configs/cheetah_quick.yaml --changes 3

A teacher trains in the source as the config says. Then the source is changed: the mass of one body and the gain of all
actuators by random factors (log-uniform, a third to three times). From the same teacher SAC goes on there for several
shares of its first training. ``regained`` is how much of the loss each wins back: 0 is the teacher as it was, 1 the
best of all. No target is looked at, which is why a config may take ``teacher.adapt`` from here. Writes
results/adaptation.csv.
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
import yaml
from tables import replace_rows

from cli.provenance import cpu_model, git_commit
from idapt_pl.effects import Domain
from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.effects.bodies import BodyMass
from idapt_pl.envs import VectorStateEnv
from idapt_pl.modules import StateSAC
from idapt_pl.rl.experts import fit_expert, measure_expert, train_expert
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import make_task

SHARES = (0.25, 0.5, 1.0, 1.5)
KEY = ("task", "seed", "change", "share")
FARTHEST = 3.0
"""Factors are between this and its inverse."""


def changed(source: Domain, seed: int) -> tuple[Domain, str]:
    """The source with a random body's mass and all actuators' gain changed at random, and in words how."""
    rng, model = np.random.default_rng(seed), source.compile()
    heavy = [b for b in range(1, model.nbody) if model.body_mass[b] > 0]
    body, (mass, gain) = rng.choice(heavy), np.exp(rng.uniform(-1, 1, 2) * np.log(FARTHEST))
    name = model.body(body).name
    effects = BodyMass(name, mass=float(model.body_mass[body] * mass)), ActuatorGain("*", gain=float(gain))
    return source.with_effects(*effects), f"mass of {name} x {mass:.2f}, gain x {gain:.2f}"


def measure(config: Path, change: int, seed: int, episodes: int) -> list[dict]:
    """A row for each share, and one for the teacher as it was."""
    settings = yaml.safe_load(config.read_text())
    task = make_task(settings["task"])
    recipe = replace(task.expert, steps=settings["teacher"]["steps"])
    stages = Stages(ROOT / f"runs/adaptation/{task.name}_{seed}", seed, cpu_trainer)
    teacher = train_expert(task, task.domain("source"), recipe, stages, "teacher")
    domain, how = changed(task.domain("source"), 100 * seed + change)

    def build() -> StateSAC:
        copy = StateSAC(**{k: teacher.hparams[k] for k in ("state_dim", "action_low", "action_high", "gamma")})
        copy.load_state_dict(teacher.state_dict())
        return copy

    reached = {0.0: measure_expert(teacher, task, domain, episodes, 7).mean}
    for share in SHARES:
        some = replace(recipe, steps=int(share * recipe.steps))
        adapted = fit_expert(
            build, lambda device: VectorStateEnv(task, domain, recipe.num_envs), some, stages, 1 + change,
            f"adapted_{some.steps}", fresh=False,
        )  # fmt: skip
        reached[share] = measure_expert(adapted, task, domain, episodes, 7).mean
    lost, best = reached[0.0], max(reached.values())
    return [
        {"task": task.name, "seed": seed, "change": how, "share": share, "steps": int(share * recipe.steps),
         "return": round(value, 1), "regained": round((value - lost) / max(best - lost, 1e-9), 2),
         "commit": git_commit(), "cpu": cpu_model()}
        for share, value in reached.items()
    ]  # fmt: skip


def main() -> None:
    """Measure every change."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", type=Path, nargs="+", required=True, help="configs with a teacher")
    p.add_argument("--changes", type=int, default=3, help="how many random changes")
    p.add_argument("--seed", type=int, default=0, help="of the teacher and of the changes")
    p.add_argument("--episodes", type=int, default=10)
    o = p.parse_args()
    for config in o.config:
        for change in range(o.changes):
            rows = measure(config, change, o.seed, o.episodes)
            print(*rows, sep="\n", flush=True)
            replace_rows(ROOT / "results/adaptation.csv", rows, KEY)


if __name__ == "__main__":
    main()

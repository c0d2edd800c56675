"""Which part of the state, misread, costs a policy its return in the target? Told the true values of some, what has it?

    python benchmarks/misread.py --runs runs/half_cheetah_hard_0 --steps 0 1
    python benchmarks/misread.py --runs runs/walker2d_hard_0 --groups none all 0,1 2,3,4     # components by number

A policy acts in the target on its own estimates, in which some components are put right. ``none`` is the policy as it
is, ``all`` its head on true states: what is between them is lost in seeing. ``height`` is a planar runner's z and
dz/dt, ``pitch`` its pitch and rate. Evaluation only: the target's states are looked at, and nothing may be chosen by
them in a run. ``error`` is what the policy itself makes of these components meanwhile: the spread of estimate less
truth, as a share of the truth's own; 1 is what saying the mean would have. Writes results/misread.csv.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np
import torch

from benchmarks.tables import replace_rows
from cli.provenance import git_commit
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import Acting
from idapt_pl.run import Run

KEY = ("run", "step", "told")


def group(name: str, size: int) -> list[int]:
    """Components by name or number; states of planar runners begin with positions, less the one along the track."""
    positions = size // 2
    named = {
        "none": [],
        "all": [*range(size)],
        "height": [0, positions + 1],
        "pitch": [1, positions + 2],
        "speed": [positions],
        "angles": [*range(2, positions)],
        "rates": [*range(positions + 3, size)],
    }
    return named[name] if name in named else [int(i) for i in name.split(",")]


class Told(Acting):
    """A policy at work whose estimates have some components put right.

    Args:
        policy: acts with its mean; its encoder reads states.
        told: numbers of the components.
    """

    def __init__(self, policy: AsymmetricSAC, told: Sequence[int]) -> None:
        super().__init__(policy, deterministic=True)
        self.told, self.state = list(told), np.empty(0)
        self.wrong: list[np.ndarray] = []
        self.truth: list[np.ndarray] = []

    def _choose(self, features: torch.Tensor) -> torch.Tensor:
        encoder = self.module.actor.encoder
        true = (torch.from_numpy(self.state) - encoder.mean) / encoder.std
        self.readings, self.estimates = features, self.module.remembering(features, self.memory)
        self.wrong.append((self.estimates - true).numpy())
        self.truth.append(true.numpy())
        seen = self.estimates.clone()
        seen[:, self.told] = true[:, self.told]
        return self.module.actor(seen, self.deterministic)[0]

    def error(self, components: Sequence[int]) -> float:
        """Mean over components of the spread of their errors, as a share of that of the truth."""
        wrong, truth = (np.concatenate(x)[:, list(components)].std(0) for x in (self.wrong, self.truth))
        return float((wrong / truth).mean())


def play(run: Run, act: Told, episodes: int, seed: int) -> np.ndarray:
    """Returns of one episode each side by side, (episodes,)."""
    total, running = np.zeros(episodes), np.ones(episodes, bool)
    with closing(run.worlds.rewarded_target(episodes)) as env:
        obs, _ = env.reset(seed=seed)
        while running.any():
            act.state = obs["state"]
            obs, reward, terminations, truncations, _ = env.step(act(obs["pixels"]))
            total += reward * running
            running &= ~(terminations | truncations)
    return total


def main() -> None:
    """Measure every run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs whose target is a domain")
    p.add_argument("--steps", type=int, nargs="+", default=[0])
    p.add_argument("--groups", nargs="+", default=["none", "all", "height", "pitch", "speed", "angles", "rates"])
    p.add_argument("--episodes", type=int, default=10)
    p.add_argument("--seed", type=int, default=11, help="of resets")
    p.add_argument("--out", type=Path, default=ROOT / "results/misread.csv")
    o = p.parse_args()
    for folder in o.runs:
        run = Run.open(folder)
        for step in o.steps:
            policy = run.load_policy(folder / f"step_{step:02d}/policy/final.ckpt")
            for name in o.groups:
                told = group(name, run.worlds.dimensions["state_dim"])
                act = Told(policy, told)
                found = play(run, act, o.episodes, o.seed)
                row = {"run": folder.name, "step": step, "told": name, "episodes": o.episodes}
                row |= {"mean": round(float(found.mean()), 1), "std": round(float(found.std()), 1)}
                row |= {"error": round(act.error(told), 3) if told else "", "commit": git_commit()}
                replace_rows(o.out, [row], KEY)
                print(*row.values(), flush=True)


if __name__ == "__main__":
    main()

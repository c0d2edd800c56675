"""Targets that nobody here wrote: another physics engine, and another model of the same thing (``examples/``).

    python benchmarks/own_targets.py --example cartpole_dm_control cartpole_pybullet --seeds 0 1 2

Runs ``idapt fit`` in ``examples/`` for every seed (finished runs are not repeated) and writes results/own_targets.csv,
as ``benchmarks/quick.py`` does. ``cartpole_pybullet`` needs ``pip install pybullet``. ``--oracle 10000`` instead trains
SAC of Stable-Baselines3 for so many steps on the target's states and rewards, where that is an environment of
Gymnasium's. ``--pictures docs/own_worlds.png`` draws the starts of both worlds side by side, and runs nothing.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import gymnasium
import numpy as np
import quick
import torch
import yaml
from PIL import Image
from tables import replace_rows

from cli.provenance import cpu_model, git_commit

ROOT = Path(__file__).parents[1]


def oracle_rows(example: Path, seed: int, steps: int) -> list[dict]:
    """What SAC on the target's own states and rewards comes to there, 20 episodes with its mean action."""
    from stable_baselines3 import SAC
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor

    config = yaml.safe_load(example.read_text())
    target, source = config["target"], config["task"]
    if not str(target.get("env", "")).startswith("gymnasium:"):
        raise SystemExit(f"{example.name}: the target is no environment of Gymnasium's, so it has no states")
    env, began = gymnasium.make(target["env"].removeprefix("gymnasium:")), time.perf_counter()
    policy = SAC("MlpPolicy", env, seed=seed).learn(steps)
    returns, _ = evaluate_policy(policy, Monitor(env), 20, return_episode_rewards=True)
    common = {"task": source, "target": target.get("name") or target["env"], "run": "oracle", "method": "oracle"}
    spread = {"mean": round(float(np.mean(returns)), 2), "std": round(float(np.std(returns)), 2)}
    minutes = round((time.perf_counter() - began) / 60, 1)
    told = {"seed": seed, "metric": "return", "target_interactions": steps, "minutes": minutes}
    return [common | spread | told | {"threads": torch.get_num_threads(), "commit": git_commit(), "cpu": cpu_model()}]


COMMAND = [sys.executable, "-c", "import sys; from cli.main import main; sys.exit(main())"]


def draw(examples: Sequence[str], out: Path) -> None:
    """A column for each example: its source above its target, each at its start."""
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        for name in examples:
            picture = Path(folder) / f"{name}.png"
            command = [*COMMAND, "check", "--config", f"{name}.yaml", "--out", str(picture)]
            subprocess.run(command, cwd=ROOT / "examples", check=True, stdout=subprocess.DEVNULL)
            seen = np.asarray(Image.open(picture).convert("RGB"))
            columns.append(seen[:, : len(seen) // 2])  # two square images, one below the other
    Image.fromarray(np.concatenate(columns, 1)).save(out, optimize=True)


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--example", nargs="+", default=["cartpole_dm_control", "cartpole_pybullet", "pendulum_gymnasium"])
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--oracle", type=int, metavar="STEPS", help="train on the target's states and rewards instead")
    p.add_argument("--pictures", type=Path, metavar="PNG", help="draw the worlds instead")
    p.add_argument("--out", type=Path, default=ROOT / "results/own_targets.csv")
    o, extra = p.parse_known_args()
    if o.pictures:
        draw(o.example, o.pictures)
        return
    for name in o.example:
        for seed in o.seeds:
            if o.oracle:
                rows = oracle_rows(ROOT / f"examples/{name}.yaml", seed, o.oracle)
                replace_rows(o.out, rows, ("task", "target", "run", "seed"), quick.FIELDS)
                continue
            folder = ROOT / f"runs/example_{name}_{seed}"
            told = ["--config", f"{name}.yaml", "--seed", str(seed), "--run_dir", str(folder)]
            command = [*COMMAND, "fit", *told, *extra]
            if not (folder / "summary.json").exists():
                subprocess.run(command, cwd=ROOT / "examples", check=True)
            replace_rows(o.out, quick.rows(folder, "IDAPT"), ("task", "target", "run", "seed"), quick.FIELDS)
    print(o.out.read_text())


if __name__ == "__main__":
    main()

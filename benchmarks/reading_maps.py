"""Where does a policy's encoder see things in the target? The linear map from where they are to what is read of them.

    python benchmarks/reading_maps.py --runs runs/fetch_reach_hard_0 --steps 0 1 --positions hand=0,1,2 goal=3,4

The policy and random actions, each held for some steps, act in the target. Of what is read of every group of positions
(components of the state) the best linear map from the true ones is told: its first two rows and columns, and the turn
in them (the angle of the nearest rotation, rad). A camera that stands otherwise than the source's turns and stretches
what is read, as G shows the source's images in the target's colours but in the source's frame. Evaluation only: the
target's states are looked at. Writes results/reading_maps.csv.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

import numpy as np

from benchmarks.tables import replace_rows
from cli.provenance import git_commit
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import deterministic
from idapt_pl.run import Run

KEY = ("run", "step", "what")
HELD, RANDOM_SHARE = 8, 0.7
"""Control steps for which a random action is held, and how often it is played in place of the policy's."""


def read_in_target(
    run: Run, policy: AsymmetricSAC, episodes: int, steps: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """True states and what is read of them, both (steps * episodes, s), of episodes side by side."""
    act, rng = deterministic(policy), np.random.default_rng(seed)
    encoder = policy.actor.encoder
    mean, spread = encoder.mean.numpy(), encoder.std.numpy()
    true, read, held = [], [], np.empty(0)
    with closing(run.worlds.rewarded_target(episodes)) as env:
        low, high = env.single_action_space.low, env.single_action_space.high
        obs, _ = env.reset(seed=seed)
        for t in range(steps):
            actions = act(obs["pixels"])
            assert act.readings is not None
            true.append(obs["state"].copy())
            read.append(act.readings.numpy() * spread + mean)
            if t % HELD == 0:
                held = rng.uniform(low, high, actions.shape)
            random = rng.random((episodes, 1)) < RANDOM_SHARE
            obs = env.step(np.where(random, held, actions).astype(np.float32))[0]
    return np.concatenate(true), np.concatenate(read)


def linear_map(true: np.ndarray, read: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The map (p, p) that predicts what is read, and the spread of what it leaves (p,)."""
    x, y = true - true.mean(0), read - read.mean(0)
    solved = np.linalg.lstsq(x, y, rcond=None)[0]
    return solved.T, (y - x @ solved).std(0)


def turn(m: np.ndarray) -> float:
    """Angle of the rotation of the plane that is nearest to a map (2, 2), rad (orthogonal Procrustes)."""
    return float(np.arctan2(m[1, 0] - m[0, 1], m[0, 0] + m[1, 1]))


def main() -> None:
    """Measure every run."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--runs", type=Path, nargs="+", required=True, help="folders of runs whose target is a domain")
    p.add_argument("--steps", type=int, nargs="+", default=[0])
    p.add_argument("--positions", nargs="+", default=["hand=0,1,2", "goal=3,4"], help="NAME=components, x and y first")
    p.add_argument("--episodes", type=int, default=8)
    p.add_argument("--length", type=int, default=45, help="control steps of an episode")
    p.add_argument("--seed", type=int, default=5, help="of resets and random actions")
    p.add_argument("--out", type=Path, default=ROOT / "results/reading_maps.csv")
    o = p.parse_args()
    for folder in o.runs:
        run = Run.open(folder)
        for step in o.steps:
            policy = run.load_policy(folder / f"step_{step:02d}/policy/final.ckpt")
            true, read = read_in_target(run, policy, o.episodes, o.length, o.seed)
            for what, told in (group.split("=") for group in o.positions):
                components = [int(i) for i in told.split(",")]
                m, left = linear_map(true[:, components], read[:, components])
                names = ("xx", "xy", "yx", "yy")
                row = {"run": folder.name, "step": step, "what": what, "turn": round(turn(m[:2, :2]), 3)}
                row |= {n: round(float(v), 3) for n, v in zip(names, m[:2, :2].flat, strict=True)}
                row |= {
                    "last": round(float(m[-1, -1]), 3),
                    "left": round(float(left.mean()), 4),
                    "commit": git_commit(),
                }
                replace_rows(o.out, [row], KEY)
                print(*row.values(), flush=True)


if __name__ == "__main__":
    main()

"""The pictures of the docs: the three domains, and a finished run's translation and transfer.

python benchmarks/pictures.py --run runs/inverted_pendulum_hard_0
python benchmarks/pictures.py --run runs/walker2d_hard_0 --gif walker.gif
"""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path

import imageio.v3 as iio
import numpy as np

import idapt_pl  # noqa: F401  sets the rendering backend before mujoco is imported
from idapt_pl.envs import VectorImageEnv
from idapt_pl.evaluation.paired import paired_stacks
from idapt_pl.evaluation.video import gif, record_video, side_by_side
from idapt_pl.rl.policy import deterministic
from idapt_pl.run import Run
from idapt_pl.tasks import make_task

DOCS = Path(__file__).parents[1] / "docs"


def domains(task_name: str, size: int = 200) -> np.ndarray:
    """Source, easy and hard in the same state, side by side; uint8 (H, W, 3)."""
    task, frames = make_task(task_name), []
    for domain in task.domains().values():
        with closing(VectorImageEnv(task, domain, 1, size)) as env:
            frames.append(env.set_state(0, np.array([0.15, 0.15]), np.zeros(2))[None])
    return side_by_side(*frames, scale=1)[0]


def transfer(folder: Path) -> bytes:
    """Source | translated | target in the same states, and the transferred policy in the target, as a GIF."""
    run = Run.open(folder)
    worlds, twin = run.worlds, run.worlds.target_twin()
    if twin is None:
        raise ValueError(f"{folder}: its target cannot be put into the source's states, so nothing can be paired")
    policy, G = run.load_policy(sorted(folder.glob("step_*/policy/final.ckpt"))[-1]), run.load_visual()
    source, target, _ = paired_stacks(worlds, twin, policy, G, 40, seed=1)
    frames = source if G.frames > 1 else source[:, -1:]
    with closing(worlds.rewarded_target(1)) as env:
        played, _ = record_video(env, deterministic(policy), 40, seed=1)
    return gif(side_by_side(source[:, -1], G.translate(frames)[:, -1], target[:, -1], played))


def main() -> None:
    """Write the pictures."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--run", type=Path, help="finished run; without it only the domains are drawn")
    p.add_argument("--gif", default="transfer.gif", help="name in docs/ of the run's picture")
    o = p.parse_args()
    iio.imwrite(DOCS / "domains.png", domains("inverted_pendulum"))
    if o.run:
        (DOCS / o.gif).write_bytes(transfer(o.run))


if __name__ == "__main__":
    main()

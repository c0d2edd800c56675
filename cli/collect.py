"""``idapt collect``: play a policy in a domain and write what happened to a trajectory file."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from tqdm import tqdm

from cli.arguments import parser, show_bar
from datamodules import write_trajectories
from idapt_pl.envs import BlindTarget, VectorImageEnv
from idapt_pl.ledger import Ledger
from idapt_pl.rollout import collect, random_policy
from idapt_pl.tasks import TASKS, make_task

POLICIES = ("random",)


def main(args: list[str]) -> int:
    """Run ``idapt collect``."""
    p = parser("collect", __doc__)
    p.add_argument("--task", choices=TASKS, required=True)
    p.add_argument("--domain", choices=("source", "easy", "hard"), required=True)
    p.add_argument("--policy", choices=POLICIES, default="random")
    p.add_argument("--steps", type=int, default=20_000, help="control steps")
    p.add_argument("--image-size", type=int, default=100, help="side of the images, pixels")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, required=True, help="trajectory file to write (HDF5)")
    o = p.parse_args(args)
    if o.steps < 1:
        raise ValueError(f"--steps must be at least 1, got {o.steps}")
    task = make_task(o.task)
    env = VectorImageEnv(task, task.domain(o.domain), 1, o.image_size, frame_stack=1)
    if o.domain != "source":  # a target shows images and actions, whoever records it
        env = BlindTarget(env, Ledger(o.out.with_suffix(".ledger.json")), 0, "training")
    with closing(env), tqdm(total=o.steps, unit="step", disable=not show_bar()) as bar:
        policy = random_policy(env, o.seed)

        def act(pixels):
            bar.update(env.num_envs)
            return policy(pixels)

        trajectories = collect(
            env, act, o.steps, o.seed, f"idapt collect: {o.task} {o.domain} {o.policy} seed {o.seed}"
        )
    write_trajectories(o.out, trajectories)
    print(f"{o.out}: {len(trajectories)} episodes, {trajectories.total_steps} steps, dt {trajectories.dt:g} s")
    return 0

"""``idapt collect``: play policies in a domain and write what happened to a trajectory file.

Policies: ``random`` (uniform actions), ``expert`` (trained on the task), ``backwards`` (paid for going the other way),
or several joined by ``+``, which share the steps evenly. Experts are trained on states in the source, once, and kept.
In a target too they act on the true state, as a person at the controls would; the file holds images and actions only.
"""

from __future__ import annotations

import hashlib
import json
import re
from contextlib import closing
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
from tqdm import tqdm

from cli.arguments import add_task_options, parser, show_bar
from cli.provenance import git_commit
from datamodules import Trajectories, write_trajectories
from datamodules.trajectories import content_hash
from idapt_pl.envs import BlindTarget, ImageEnv, VectorImageEnv
from idapt_pl.envs.ledger import Ledger
from idapt_pl.modules import StateSAC
from idapt_pl.ranges import COUNT, IMAGE_SIZE, SEED, check_ranges
from idapt_pl.rl.collect import collect
from idapt_pl.rl.experts import train_expert
from idapt_pl.rl.exploration import random_policy
from idapt_pl.rl.policy import Policy
from idapt_pl.stage import Stages, cpu_trainer
from idapt_pl.tasks import SOURCES, TASKS, Task, make_task

POLICIES = ("random", "backwards", "expert", "random+expert", "random+backwards+expert")


def main(args: list[str]) -> int:
    """Run ``idapt collect``.

    Raises:
        ValueError: if there are fewer steps than policies.
    """
    p = parser("collect", __doc__)
    p.add_argument("--task", required=True, help=f"one of: {', '.join(TASKS)}; {SOURCES}")
    add_task_options(p)
    p.add_argument("--domain", required=True, help="source, easy or hard; other tasks may have others, or source alone")
    p.add_argument("--policy", choices=POLICIES, default="random")
    p.add_argument("--steps", type=int, default=20_000, help="control steps")
    p.add_argument("--image-size", type=int, default=100, help="side of the images, pixels")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--experts", type=Path, default=Path("runs/experts"), help="where trained policies are kept")
    p.add_argument("--out", type=Path, required=True, help="trajectory file to write (HDF5)")
    o = p.parse_args(args)
    kinds = o.policy.split("+")
    if o.steps < len(kinds):
        raise ValueError(f"--steps must be at least {len(kinds)}, got {o.steps}")
    values = {"--steps": o.steps, "--image-size": o.image_size, "--seed": o.seed}
    check_ranges("", values, {"--steps": COUNT, "--image-size": IMAGE_SIZE, "--seed": SEED})
    if o.out.is_dir():
        raise ValueError(f"{o.out}: --out is a folder; name a file")
    task = make_task(o.task, o.task_options)
    domain, experts = task.domain(o.domain), o.experts / folder_name(o.task, o.task_options)
    checkpoints = {kind: expert(task, kind, o.seed, experts) for kind in kinds if kind != "random"}
    recorded = VectorImageEnv(task, domain, 1, o.image_size, frame_stack=1)
    env: ImageEnv = recorded
    if o.domain != "source":  # a target shows images and actions, whoever records it
        env = BlindTarget(recorded, Ledger(o.out.with_suffix(".ledger.json")), 0, "training")
    parts: list[Trajectories] = []
    with closing(env), tqdm(total=o.steps, unit="step", disable=not show_bar()) as bar:
        for i, kind in enumerate(kinds):
            expert_policy = checkpoints.get(kind)
            policy = acting_on_states(expert_policy[0], recorded) if expert_policy else random_policy(env, o.seed)
            share = o.steps * (i + 1) // len(kinds) - o.steps * i // len(kinds)
            L.seed_everything(o.seed, verbose=False)  # experts draw their actions
            parts.append(collect(env, counted(policy, bar, env), share, o.seed + i, ""))
    episodes = tuple(episode for part in parts for episode in part)
    told = {"made_by": "idapt collect", "task": o.task, "domain": o.domain, "policy": o.policy, "seed": o.seed}
    told |= {"task_options": o.task_options} if o.task_options else {}
    told |= {"commit": git_commit(), "experts_sha256": {kind: digest for kind, (_, digest) in checkpoints.items()}}
    told["content_sha256"] = content_hash(episodes)
    trajectories = Trajectories(episodes, parts[0].dt, json.dumps(told))
    write_trajectories(o.out, trajectories)
    print(f"{o.out}: {len(trajectories)} episodes, {trajectories.total_steps} steps, dt {trajectories.dt:g} s")
    print(f"sha256 of its content {told['content_sha256']}")
    return 0


def folder_name(task: str, options: dict[str, Any]) -> str:
    """A task with its options as the name of a folder."""
    told = "_" + hashlib.sha256(json.dumps(options, sort_keys=True, default=str).encode()).hexdigest()[:8]
    return re.sub(r"[^\w.-]+", "_", task) + told * bool(options)


def counted(policy: Policy, bar: tqdm, env: ImageEnv) -> Policy:
    """The policy, moving the bar with every action."""

    def act(pixels: np.ndarray) -> np.ndarray:
        bar.update(env.num_envs)
        return policy(pixels)

    return act


def expert(task: Task, kind: str, seed: int, cache: Path) -> tuple[StateSAC, str]:
    """A policy on states, trained in the source or loaded, and its checkpoint's SHA-256.

    Args:
        task: what it is an expert of.
        kind: ``"expert"``, or ``"backwards"`` for one that is paid for going the other way.
        seed: of its training.
        cache: folder where experts of this task are kept.
    """
    trained = task.backwards() if kind == "backwards" else task
    stages = Stages(cache / f"{kind}_{seed}", seed, cpu_trainer)
    policy = train_expert(trained, task.domain("source"), task.expert, stages, "policy")
    checkpoint = stages.folder(0) / "policy" / "final.ckpt"
    return policy, hashlib.sha256(checkpoint.read_bytes()).hexdigest()


def acting_on_states(policy: StateSAC, env: VectorImageEnv) -> Policy:
    """A policy on states as one that is asked with images: it reads the simulations behind them.

    In a target that is the true state, which nothing that learns may see; the file that is written does not hold it.
    """

    def act(pixels: np.ndarray) -> np.ndarray:
        return policy.act(np.asarray([env.task.state(env.model, data) for data in env.data], np.float32))

    return act

"""``idapt export``: the policy of a run as one ONNX file for the robot, and a small program that plays it."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch

from cli.arguments import keep_inputs, parser
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.envs.action_map import ActionMap
from idapt_pl.files import write_atomically
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.modules.policy_export import DeployedPolicy, export_policy, open_session, played_by_file
from idapt_pl.rl.policy import deterministic
from idapt_pl.run import Run
from idapt_pl.targets import target_name

TOLERANCE = 1e-4
"""Share of an action's range by which the file may differ from the run's policy; more is an error."""

TIMED = 200
"""Calls whose time is told."""


def main(args: list[str]) -> int:
    """Run ``idapt export``.

    Raises:
        RuntimeError: if the file would not act as the policy does; it is not kept.
    """
    p = parser("export", __doc__)
    p.add_argument("--run", type=Path, required=True, help="run folder")
    p.add_argument("--out", type=Path, required=True, help="file to write, ending in .onnx; play.py comes beside it")
    p.add_argument("--step", type=int, help="grounding step; default the last that has a policy")
    o = p.parse_args(args)
    run = Run.open(o.run)
    checkpoint = chosen_checkpoint(o.run, o.step)
    keep_inputs(o.out, [checkpoint])
    policy = run.load_policy(checkpoint)
    write_policy(run, policy, o.out, checkpoint)
    stacks, recording = recorded_stacks(run, checkpoint)
    difference = largest_difference(policy, o.out, stacks, run.worlds.actions)
    if not difference <= TOLERANCE:
        o.out.unlink()
        raise RuntimeError(f"{o.out} would act differently by {difference:.2g} of an action's range; it was not kept")
    play = o.out.with_name("play.py")
    if not play.exists():
        text = Path(__file__).with_name("play.py").read_text()
        write_atomically(play, lambda temporary: temporary.write_text(text))
    print(f"{o.out}: acts as {checkpoint} on {len(stacks)} frames of {recording}, within {difference:.1e} of the range")
    print(f"one action takes {1000 * latency(o.out, stacks[:1]):.1f} ms on one core of this machine")
    print(f"what it takes and gives: python {play} {o.out} --about")
    return 0


def chosen_checkpoint(folder: Path, step: int | None) -> Path:
    """The policy of a grounding step.

    Raises:
        ValueError: if there is none.
    """
    made = sorted(folder.glob("step_*/policy/final.ckpt"))
    names = {int(path.parent.parent.name.removeprefix("step_")): path for path in made}
    if not names:
        raise ValueError(f"{folder} has no finished policy yet; go on: idapt fit --config {folder / 'config.yaml'}")
    if step is not None and step not in names:
        raise ValueError(f"--step is {step}; {folder} has policies of the steps {', '.join(map(str, names))}")
    return names[max(names) if step is None else step]


def write_policy(run: Run, policy: AsymmetricSAC, path: Path, checkpoint: Path) -> None:
    """Write the file."""
    c, actions = run.config, run.worlds.actions
    about = {
        "period": run.worlds.period,
        "low": actions.ends[0].tolist(),
        "high": actions.ends[1].tolist(),
        "actions": actions.names,
        "task": c.task,
        "target": target_name(c.target),
        "seed": c.seed,
        "policy": checkpoint.parent.parent.name,
    }
    deployed = DeployedPolicy(policy, actions.order, actions.scale, actions.offset, *actions.ends)
    export_policy(deployed, path, c.frame_stack, c.image_size, about)


def recorded_stacks(run: Run, checkpoint: Path) -> tuple[np.ndarray, Path]:
    """Frame stacks of an episode of the target that the run has recorded, (T+1, K, S, S, 3), and its file."""
    path = max(p for p in run.folder.glob("step_*/target.h5") if p.parent.name <= checkpoint.parent.parent.name)
    longest = max(read_all([path]), key=len)
    return FrameStacks([longest], run.config.frame_stack).stacks(np.arange(len(longest))), path


@torch.no_grad()
def largest_difference(policy: AsymmetricSAC, path: Path, stacks: np.ndarray, actions: ActionMap) -> float:
    """Between the run's policy and a file, over an episode, as a share of an action's range; both in float32."""
    policy.hparams.bf16 = False
    act = deterministic(policy)
    expected = np.array([actions(act(stack[None]))[0] for stack in stacks])
    low, high = actions.ends
    return float((np.abs(played_by_file(path, stacks) - np.clip(expected, low, high)) / (high - low)).max())


def latency(path: Path, stack: np.ndarray) -> float:
    """Median time that a file takes for one action, s."""
    session, taken = open_session(path), []
    inputs = {i.name: np.zeros(i.shape, np.float32) for i in session.get_inputs()} | {"pixels": stack}
    for _ in range(TIMED):
        begin = time.perf_counter()
        session.run(None, inputs)
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))

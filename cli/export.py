"""``idapt export``: the policy of a run as one ONNX file for the robot, and a small program that plays it."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from cli.arguments import keep_inputs, parser
from datamodules.stacks import FrameStacks
from datamodules.unpaired import read_all
from idapt_pl.deployment import TOLERANCE, largest_difference, open_session, write_play, write_policy
from idapt_pl.run import Run
from idapt_pl.targets import target_name

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
    checkpoint = chosen_checkpoint(run, o.step)
    keep_inputs(o.out, [checkpoint])
    policy = run.load_policy(checkpoint)
    about = {"task": run.config.task, "target": target_name(run.config.target), "seed": run.config.seed}
    write_policy(o.out, policy, run.worlds, about | {"policy": checkpoint.parent.parent.name})
    stacks, recording = recorded_stacks(run, checkpoint)
    difference = largest_difference(o.out, policy, run.worlds.actions, stacks)
    if not difference <= TOLERANCE:
        o.out.unlink()
        raise RuntimeError(f"{o.out} would act differently by {difference:.2g} of an action's range; it was not kept")
    play = write_play(o.out.parent)
    print(f"{o.out}: acts as {checkpoint} on {len(stacks)} frames of {recording}, within {difference:.1e} of the range")
    print(f"one action takes {1000 * latency(o.out, stacks[:1]):.1f} ms on one core of this machine")
    print(f"what it takes and gives: python {play} {o.out} --about")
    return 0


def chosen_checkpoint(run: Run, step: int | None) -> Path:
    """The policy of a grounding step, or that of a run in the source alone.

    Raises:
        ValueError: if there is none, or it has LSTMs.
    """
    folder, alone = run.folder, run.folder / "step_00/source_policy/final.ckpt"
    if run.config.modules["policy"]["recurrent"]:
        raise ValueError(f"{folder}: policies with policy.recurrent cannot be exported; set it to 0 and train again")
    if run.config.method == "source" and alone.exists() and not step:
        return alone
    made = sorted(folder.glob("step_*/policy/final.ckpt"))
    names = {int(path.parent.parent.name.removeprefix("step_")): path for path in made}
    if not names:
        raise ValueError(f"{folder} has no finished policy yet; go on: idapt fit --config {folder / 'config.yaml'}")
    if step is not None and step not in names:
        raise ValueError(f"--step is {step}; {folder} has policies of the steps {', '.join(map(str, names))}")
    return names[max(names) if step is None else step]


def recorded_stacks(run: Run, checkpoint: Path) -> tuple[np.ndarray, Path]:
    """Frame stacks (T, K, S, S, 3) of an episode of the target (or the source, if that is all), and its file."""
    recordings = [*run.folder.glob("step_*/target.h5"), run.folder / "step_00/source.h5"]  # of one step the target's
    path = max(p for p in recordings if p.parent.name <= checkpoint.parent.parent.name)
    longest = max(read_all([path]), key=len)
    return FrameStacks([longest], run.config.frame_stack).stacks(np.arange(len(longest))), path


def latency(path: Path, stack: np.ndarray) -> float:
    """Median time that a file takes for one action, s."""
    session, taken = open_session(path), []
    inputs = {i.name: np.zeros(i.shape, np.float32) for i in session.get_inputs()} | {"pixels": stack}
    for _ in range(TIMED):
        begin = time.perf_counter()
        session.run(None, inputs)
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))

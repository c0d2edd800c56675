"""What a person is asked for who records the target by hand."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from torch import nn

from datamodules.atomic import write_atomically
from datamodules.episode_folder import ACTIONS
from datamodules.users_error import WholeError
from idapt_pl.deployment import write_play, write_policy
from idapt_pl.rl.policy import Acting, Policy, tick
from idapt_pl.targets import RecordedTarget
from idapt_pl.targets.recorded import ENOUGH
from idapt_pl.worlds import Worlds

PLAN = "actions_to_play.csv"
"""Actions that explore, a row for each control step."""

POLICY = "policy.onnx"
"""The policy that is to be recorded."""

MARK = "policy.sha256"
"""Of its weights: recordings beside it are of this policy, and of no other run's."""


class TargetNeeded(WholeError):
    """The run waits for recordings of the target; the message says which."""

    exit_code = 3


def ask_for_recording(
    worlds: Worlds, target: RecordedTarget, k: int, policy: Policy, steps: int, command: str, horizon: int | None = None
) -> None:
    """Say what is missing of the recordings of a grounding step, and put beside it what is to be played.

    Args:
        worlds: of the run.
        target: where recordings are put by hand.
        k: grounding step.
        policy: explores, or acts on images.
        steps: control steps that are wanted.
        command: that goes on.
        horizon: control steps after which exploration begins anew; None where the robot must be reset.

    Raises:
        TargetNeeded: if there are too few yet.
        ValueError: if they are of another policy.
    """
    brought, place = target.steps_brought(k), target.place(k)
    if brought and isinstance(policy, Acting):
        check_policy(place, k, policy)
    if brought >= ENOUGH * steps:
        return
    place.mkdir(parents=True, exist_ok=True)
    if isinstance(policy, Acting):
        write_atomically(place / MARK, lambda temporary: temporary.write_text(weights_hash(policy.module)))
        write_policy(place / POLICY, policy.module, worlds, {"policy": f"step_{k - 1:02d}"})
        write_play(place)
        which = f"the policy of step {k - 1}, {place / POLICY}"
        play = f"{which}; play.py beside it shows how, and needs onnxruntime, numpy and pillow"
    else:
        write_plan(place / PLAN, worlds, policy, steps, horizon)
        often = f"after every {horizon} of them" if horizon else "where it must be"
        play = f"the actions in {place / PLAN}, a row for each control step; reset the robot {often}, and go on"
    low, high = worlds.actions.ends
    names = worlds.actions.names or [str(i) for i in range(len(low))]
    ranges = ", ".join(f"{n} {a:g} to {b:g}" for n, a, b in zip(names, low, high, strict=True))
    missing = f"{steps} control steps of {target.name}, {worlds.period:g} s each; there are {brought}"
    raise TargetNeeded(
        f"""grounding step {k} needs {missing}.

  Play    {play}
  Record  in {place}, a folder for each episode with
            its pictures (.png or .jpg), in the order of their names: one before the first action, one after each
            {ACTIONS}, a row for each action as it was sent ({ranges})
          or trajectory files (.h5, docs/reference/files.md)
  Then    {command}"""
    )


def check_policy(place: Path, k: int, policy: Acting) -> None:
    """What was recorded must be of the policy that was asked for.

    Raises:
        ValueError: if it is of another.
    """
    mark = place / MARK
    if not mark.exists() or mark.read_text() != weights_hash(policy.module):
        raise ValueError(
            f"{place} holds recordings that are not of this run's policy of step {k - 1}: they are another run's, or "
            "were there before it was asked for. Move them away, or give this run a folder of its own "
            "(target: {by_hand: ...})"
        )


def weights_hash(module: nn.Module) -> str:
    """SHA-256 of all weights, hexadecimal."""
    digest = hashlib.sha256()
    for name, value in sorted(module.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.cpu().numpy().tobytes())
    return digest.hexdigest()


def write_plan(path: Path, worlds: Worlds, policy: Policy, steps: int, horizon: int | None) -> None:
    """A table of actions that explore, in the target's units, unless there is one."""
    if path.exists():
        return
    blind = np.zeros((1, worlds.frame_stack, worlds.image_size, worlds.image_size, 3), np.uint8)
    to_target, actions = worlds.actions, []
    for t in range(1, steps + 1):
        actions.append(to_target(policy(blind))[0])
        tick(policy, np.array([horizon is not None and t % horizon == 0]))
    names = to_target.names or [str(i) for i in range(len(actions[0]))]
    rows = [",".join(names), *(",".join(f"{value:.6g}" for value in row) for row in actions)]
    write_atomically(path, lambda temporary: temporary.write_text("\n".join(rows) + "\n"))

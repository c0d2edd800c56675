"""Writes what a robot needs of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from idapt_pl.deployment.onnx_policy import DeployedPolicy, export_policy, played_by_file
from idapt_pl.envs import ActionMap
from idapt_pl.files import write_atomically
from idapt_pl.modules import AsymmetricSAC
from idapt_pl.rl.policy import deterministic
from idapt_pl.worlds import Worlds

TOLERANCE = 1e-4
"""Share of an action's range by which a file may differ from the run's policy."""


def write_policy(path: Path, policy: AsymmetricSAC, worlds: Worlds, about: dict[str, Any]) -> None:
    """Write a policy as an ``.onnx`` file that acts in the target's units.

    Args:
        path: of the file.
        policy: acts with its mean.
        worlds: of the run.
        about: what else is to be in the file's metadata.
    """
    actions = worlds.actions
    low, high = actions.ends
    known = {"period": worlds.period, "low": low.tolist(), "high": high.tolist(), "actions": actions.names}
    deployed = DeployedPolicy(policy, actions.order, actions.scale, actions.offset, low, high)
    export_policy(deployed, path, worlds.frame_stack, worlds.image_size, known | about)


def write_play(folder: Path) -> Path:
    """Put ``play.py`` into a folder, unless there is one, which may have been filled in. Returns its path."""
    path = folder / "play.py"
    if not path.exists():
        text = Path(__file__).with_name("play.py").read_text()
        write_atomically(path, lambda temporary: temporary.write_text(text))
    return path


@torch.no_grad()
def largest_difference(path: Path, policy: AsymmetricSAC, actions: ActionMap, stacks: np.ndarray) -> float:
    """Between the run's policy and a file, over an episode, as a share of an action's range; both in float32.

    Args:
        path: of the file.
        policy: of the run.
        actions: the policy's to the target's.
        stacks: of frames, uint8 (T, K, S, S, 3).
    """
    policy.hparams.bf16 = False
    act = deterministic(policy)
    low, high = actions.ends
    expected = np.clip([actions(act(stack[None]))[0] for stack in stacks], low, high)
    return float((np.abs(played_by_file(path, stacks) - expected) / (high - low)).max())

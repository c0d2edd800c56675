"""Modules for a stage that computes elsewhere than where they are kept."""

from __future__ import annotations

import copy
from typing import TypeVar

import torch

Lent = TypeVar("Lent", bound=torch.nn.Module)


def on_device(module: Lent, device: torch.device) -> Lent:
    """The module if it is on this device, or else a copy there.

    Between stages every module is on the CPU. ``module.to(device)`` would leave one that a stage only uses where that
    stage computes, and what comes next gives it tensors of the CPU.
    """
    if all(p.device == device for p in module.parameters()):
        return module
    return copy.deepcopy(module).to(device)

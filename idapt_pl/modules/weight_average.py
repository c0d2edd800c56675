"""Exponential moving average of weights, warmed up."""

from __future__ import annotations

import torch
from torch import Tensor


@torch.no_grad()
def warmed_up_average(decay: float, averages: list[Tensor], currents: list[Tensor], updates: Tensor) -> None:
    """A step of the exponential moving average, quick at first so that the initial weights are forgotten."""
    share = 1 - min(decay, float((1 + updates) / (10 + updates)))
    for average, current in zip(averages, currents, strict=True):
        average.lerp_(current, share)

"""What a policy is: images in, actions out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from idapt_pl.modules import AsymmetricSAC

Policy = Callable[[np.ndarray], np.ndarray]
"""A policy: pixels uint8 (n, K, H, W, 3) to actions float32 (n, nu)."""


def tick(act: Policy | None, ended: np.ndarray) -> None:
    """Tell a policy that keeps time that a control step has passed, and in which simulations it ended the episode."""
    if hasattr(act, "tick"):
        act.tick(ended)


def deterministic(policy: AsymmetricSAC) -> Policy:
    """The policy acting with its mean."""
    return lambda pixels: policy.act(pixels, deterministic=True)

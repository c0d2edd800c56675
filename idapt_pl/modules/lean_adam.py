"""Adam whose step has the arithmetic alone: no hooks, no profiler's marks.

Around a step of nets of 2 x 256 these take as long on a CPU as the step (``benchmarks/sac_speed.py``).
"""

from __future__ import annotations

import torch
from torch.optim.adam import adam


class LeanAdam(torch.optim.Adam):
    """``torch.optim.Adam(fused=True)`` with the same state and a second way to take a step, :meth:`update`."""

    @torch.no_grad()
    def update(self) -> None:
        """What :meth:`step` does to parameters and state, bit for bit; hooks of steps are not called."""
        moving = [[p for p in group["params"] if p.grad is not None] for group in self.param_groups]
        if not all(self.state[p] for moved in moving for p in moved):  # the first step makes them
            self.step()
            return
        for group, moved in zip(self.param_groups, moving, strict=True):
            states = [self.state[p] for p in moved]
            adam(
                moved, [p.grad for p in moved], [s["exp_avg"] for s in states], [s["exp_avg_sq"] for s in states], [],
                [s["step"] for s in states], fused=True, amsgrad=False, beta1=group["betas"][0],
                beta2=group["betas"][1], lr=group["lr"], weight_decay=group["weight_decay"], eps=group["eps"],
                maximize=False,
            )  # fmt: skip

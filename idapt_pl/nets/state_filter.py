"""The state from readings over time: what single images tell, held together by time and the policy's own actions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.units import Units, give_in_units, take_in_units

FARTHEST = 10.0
"""Spreads from the mean at which a reading is cut off, as no state is there."""
LOST = 3.0
"""Usual corrections (95 % quantiles in training) that readings are off by on average where the state is lost."""


@dataclass
class Memory:
    """What a filter knows of n episodes that are under way.

    Attributes:
        hidden: of the GRU, (n, h).
        action: the last one taken, -1..1, (n, nu); 0 before the first.
        reading: the last one, standardised, (n, s).
        lost: how often the state was lost so far, int (n,).
        steps: readings so far.
    """

    hidden: Tensor
    action: Tensor
    reading: Tensor
    lost: Tensor
    steps: int = 0

    def forget(self, which: Bool[Tensor, " n"]) -> None:
        """Begin anew in some episodes."""
        for part in (self.hidden, self.action, self.reading):
            part[which] = 0.0

    def copy(self) -> Memory:
        """As it is now."""
        parts = {name: getattr(self, name).clone() for name in ("hidden", "action", "reading", "lost")}
        return replace(self, **parts)

    def put_back(self, before: Memory, which: Bool[Tensor, " n"]) -> None:
        """What is known of some episodes is what it was before."""
        for name in ("hidden", "action", "reading", "lost"):
            getattr(self, name)[which] = getattr(before, name)[which]


class StateFilter(nn.Module):
    """Estimates of the state from readings of it, one after the other, and the actions between them.

    A gated recurrent unit (Cho et al. 2014) corrects the newest reading; a new filter gives readings as they are.
    Learned where true states are known, it does what a Kalman filter does with a model of dynamics and sensor.

    Args:
        state_dim: s, of standardised states.
        action_dim: nu, of actions as -1..1.
        hidden: size of the memory and of the layer behind it.
    """

    def __init__(self, state_dim: int, action_dim: int, hidden: int = 128) -> None:
        super().__init__()
        self.state_dim, self.action_dim, self.hidden = state_dim, action_dim, hidden
        self.gru = nn.GRU(state_dim + action_dim, hidden, batch_first=True)
        self.correction = mlp(hidden + state_dim, [hidden], state_dim)
        nn.init.zeros_(self.correction[-1].weight)
        nn.init.zeros_(self.correction[-1].bias)
        self.register_buffer("usual_correction", torch.full((state_dim,), 2 * FARTHEST))  # a new one loses nothing

    def forward(
        self, readings: Float[Tensor, "b t s"], actions: Float[Tensor, "b t a"], hidden: Float[Tensor, "b h"]
    ) -> tuple[Float[Tensor, "b t s"], Float[Tensor, "b h"]]:
        """Estimates for every time, and the memory after the last.

        Args:
            readings: standardised states as they are read.
            actions: those taken just before each reading, -1..1.
            hidden: the memory before the first.
        """
        seen = readings.clamp(-FARTHEST, FARTHEST)
        out, last = self.gru(torch.cat([seen, actions], -1), hidden[None].contiguous())
        return seen + self.correction(torch.cat([out, seen], -1)), last[0]

    def begin(self, n: int) -> Memory:
        """What is known before the first reading of n episodes."""
        like = self.gru.weight_hh_l0
        hidden, action, reading = (like.new_zeros(n, d) for d in (self.hidden, self.action_dim, self.state_dim))
        return Memory(hidden, action, reading, lost=like.new_zeros(n, dtype=torch.int))

    @torch.no_grad()
    def step(self, readings: Float[Tensor, "n s"], memory: Memory) -> Float[Tensor, "n s"]:
        """Finite estimates for now; ``memory`` goes on. In place of a reading that is no number stands the last one.

        Where readings are far from what is made of them, the state is lost: the filter begins anew with the reading.
        """
        memory.reading = torch.where(torch.isfinite(readings), readings, memory.reading)
        seen, actions, before = memory.reading[:, None], memory.action[:, None], memory.hidden
        estimates, memory.hidden = self(seen, actions, before)
        lost = self.lost(memory.reading, estimates[:, 0])
        if lost.any():
            kept = (~lost).to(before.dtype)[:, None]
            estimates, memory.hidden = self(seen, actions * kept[..., None], before * kept)
        memory.lost += lost.int()
        memory.steps += 1
        return self.bounded(estimates[:, 0])

    @staticmethod
    def bounded(estimates: Float[Tensor, "n s"]) -> Float[Tensor, "n s"]:
        """Estimates within what states can be."""
        return estimates.clamp(-FARTHEST, FARTHEST)

    def lost(self, readings: Float[Tensor, "n s"], estimates: Float[Tensor, "n s"]) -> Bool[Tensor, " n"]:
        """Where readings are much further from estimates than they were in training."""
        return ((readings - estimates).abs() / self.usual_correction).mean(-1) > LOST

    @torch.no_grad()
    def tell_in_units(self, before: Units, now: Units) -> None:
        """Make the same of readings that are standardised by ``now`` and no longer by ``before``."""
        first, last = self.correction[0], self.correction[-1]
        take_in_units(self.gru.weight_ih_l0[:, : self.state_dim], self.gru.bias_ih_l0, before, now)
        take_in_units(first.weight[:, self.hidden :], first.bias, before, now)
        give_in_units(last.weight, last.bias, before.of_differences, now.of_differences)
        self.usual_correction *= before.std / now.std

    @torch.no_grad()
    def learn_usual_correction(self, corrections: Float[Tensor, "n s"]) -> None:
        """Take what is usual from differences between readings and estimates."""
        self.usual_correction.copy_(corrections.abs().quantile(0.95, 0).clamp_min(1e-3))

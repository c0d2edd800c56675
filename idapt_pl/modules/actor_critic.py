"""The nets of soft actor-critic: an actor, and two critics."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from idapt_pl.losses import squashed_log_prob
from idapt_pl.nets.encoder import orthogonal_init
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.relu_net import linear_layers, relu_net

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)
LOG_STD_MIDDLE, LOG_STD_REACH = -1.5, 3.5
"""Logarithms of an actor's spread are within so much of the middle, [-5, 2]."""


class Actor(nn.Module):
    """π(a|o): an encoder f of observations and an MLP head, a tanh-squashed Gaussian scaled to the action bounds.

    Args:
        encoder: f; its ``features`` is the size d of f(o).
        action_low: lower bounds (nu,), in the actuators' units.
        action_high: upper bounds (nu,).
        hidden: of the head.
        seen: size of what the head sees of f(o), if that is not f(o) itself.
    """

    def __init__(
        self, encoder: nn.Module, action_low: Sequence[float], action_high: Sequence[float], hidden: Sequence[int],
        seen: int | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        low, high = torch.tensor(action_low), torch.tensor(action_high)
        self.encoder = encoder
        self.head = mlp(seen or encoder.features, hidden, 2 * len(low))
        self.head.apply(orthogonal_init)
        self.register_buffer("center", (high + low) / 2)
        self.register_buffer("half_range", (high - low) / 2)

    def forward(self, features: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor]:
        """Action in physical units (n, nu) and its log-probability density on (-1, 1)^nu, (n,), for f(o) (n, d)."""
        mean, log_std = self.gaussian(features)
        noise = torch.zeros_like(mean) if deterministic else torch.randn_like(mean)
        u = mean + log_std.exp() * noise
        log_prob = -0.5 * noise.square() - log_std - HALF_LOG_2PI
        return self.center + self.half_range * torch.tanh(u), squashed_log_prob(log_prob, u)

    def gaussian(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log of the spread of what is squashed by tanh and scaled to the bounds, (n, nu) each."""
        mean, log_std = values_of(self.head, features).float().chunk(2, -1)
        return mean, torch.tanh(log_std).mul(LOG_STD_REACH).add(LOG_STD_MIDDLE)

    def normalise(self, actions: Tensor) -> Tensor:
        """Actions in physical units to -1..1."""
        return (actions - self.center) / self.half_range


class TwinCritic(nn.Module):
    """Two Q(s, a) on states, never on images.

    Args:
        state_dim: size of s.
        actor: whose action bounds scale a.
        hidden: of both.
    """

    def __init__(self, state_dim: int, actor: Actor, hidden: Sequence[int]) -> None:
        super().__init__()
        inputs = state_dim + len(actor.center)
        self.nets = nn.ModuleList(mlp(inputs, hidden, 1) for _ in range(2))
        self.nets.apply(orthogonal_init)
        self.register_buffer("center", actor.center.clone())
        self.register_buffer("half_range", actor.half_range.clone())

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """Both values, (2, n), of states (n, s) and actions in physical units (n, nu)."""
        x = self.inputs(state, action)
        return torch.cat([values_of(net, x) for net in self.nets], -1).mT

    def inputs(self, state: Tensor, action: Tensor) -> Tensor:
        """What both nets see, (n, s + nu): states, and actions in -1..1."""
        return torch.cat([state, (action - self.center) / self.half_range], -1)


def values_of(net: nn.Sequential, x: Tensor) -> Tensor:
    """What ``net(x)`` returns, quicker where nobody asks for gradients."""
    if torch.is_grad_enabled() or torch.is_autocast_enabled(x.device.type):
        return net(x)
    return relu_net(linear_layers(net), x)[0]

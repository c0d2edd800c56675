"""Gradients of soft actor-critic's losses, written out for nets of linear layers and ReLU.

They are those of autograd (``tests/modules``). As one update is many small products, autograd is a fifth of
its time on a CPU.
"""

from __future__ import annotations

import torch
from torch import Tensor

from idapt_pl.losses import squashed_log_prob
from idapt_pl.modules.actor_critic import HALF_LOG_2PI, LOG_STD_MIDDLE, LOG_STD_REACH, Actor, TwinCritic
from idapt_pl.nets.relu_net import linear_layers, relu_net, relu_net_gradients


@torch.no_grad()
def critic_gradients(critic: TwinCritic, state: Tensor, action: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Set the gradients of the sum over both critics of the mean squared error.

    Args:
        critic: whose ``grad`` are set.
        state: (n, s).
        action: (n, nu), physical units.
        target: (n,).

    Returns:
        The loss, and both values, (2, n).
    """
    x, values = critic.inputs(state, action), []
    for net in critic.nets:
        layers = linear_layers(net)
        q, inputs = relu_net(layers, x)
        values.append(q[:, 0])
        relu_net_gradients(layers, inputs, (q - target[:, None]) * (2 / len(q)))
    q = torch.stack(values)
    return (q - target).square().mean() * 2, q


@torch.no_grad()
def actor_gradients(
    actor: Actor, critic: TwinCritic, log_alpha: Tensor, features: Tensor, state: Tensor, target_entropy: float | None
) -> tuple[Tensor, Tensor]:
    """Set the gradients of mean(α log π - min Q) by the actor's head, and of α's loss by log α.

    Args:
        actor: whose head's ``grad`` are set.
        critic: judges actions, and stays as it is.
        log_alpha: log α; its ``grad`` is set.
        features: f(o), (n, d).
        state: (n, s).
        target_entropy: nats; None leaves α.

    Returns:
        The loss, and log π, (n,).
    """
    layers, n, alpha = linear_layers(actor.head), len(features), log_alpha.exp()
    out, inputs = relu_net(layers, features)
    mean, reach = out.chunk(2, -1)
    reach = reach.tanh()
    log_std = LOG_STD_MIDDLE + LOG_STD_REACH * reach
    noise = torch.randn_like(mean)
    moved = log_std.exp() * noise  # by which u differs from the mean
    u = mean + moved
    action = u.tanh()
    log_prob = squashed_log_prob(-0.5 * noise.square() - log_std - HALF_LOG_2PI, u)
    q, by_action = lower_value(critic, torch.cat([state, action], -1), actions=action.shape[1])
    # log π falls with log σ, and by u through tanh's slope 1 - a², of whose logarithm the derivative is -2a.
    by_u = by_action * (action.square() - 1) / n + (2 * alpha / n) * action
    by_log_std = by_u * moved - alpha / n
    by_reach = by_log_std * LOG_STD_REACH * (1 - reach.square())
    relu_net_gradients(layers, inputs, torch.cat([by_u, by_reach], -1))
    if target_entropy is not None:
        log_alpha.grad = -alpha * (log_prob.mean() + target_entropy)
    return (alpha * log_prob - q).mean(), log_prob


def lower_value(critic: TwinCritic, x: Tensor, actions: int) -> tuple[Tensor, Tensor]:
    """The lower of both values, (n,), and its gradient by the last components of x (n, s + nu), the actions (n, nu)."""
    nets = [linear_layers(net) for net in critic.nets]
    (q_1, inputs_1), (q_2, inputs_2) = (relu_net(layers, x) for layers in nets)
    first = (q_1 < q_2).float()
    by_x = [
        relu_net_gradients(layers, inputs, lower, of_weights=False, of_input=True)
        for layers, inputs, lower in zip(nets, (inputs_1, inputs_2), (first, 1 - first), strict=True)
    ]
    assert by_x[0] is not None and by_x[1] is not None  # asked for
    return torch.minimum(q_1, q_2)[:, 0], (by_x[0] + by_x[1])[:, -actions:]

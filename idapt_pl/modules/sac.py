"""Soft actor-critic, whatever the actor sees: images (:mod:`.policy`) or states (:mod:`.state_policy`)."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.losses import sac_target, squashed_log_prob
from idapt_pl.modules.manual import ManualModule
from idapt_pl.modules.observation_noise import NoObservationNoise
from idapt_pl.nets.encoder import orthogonal_init
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.relu_net import relu_net
from idapt_pl.nets.state_filter import Memory

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


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
        mean, log_std = relu_net(self.head, features).float().chunk(2, -1)
        return mean, torch.tanh(log_std).mul(3.5).sub(1.5)  # in [-5, 2]

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

    def forward(self, state: Tensor, action: Tensor, frozen: bool = False) -> Tensor:
        """Both values, (2, n), of states (n, s) and actions in physical units (n, nu); ``frozen`` as they are."""
        x = torch.cat([state, (action - self.center) / self.half_range], -1)
        return torch.cat([relu_net(net, x, frozen) for net in self.nets], -1).mT


class SAC(ManualModule, ABC):
    """Soft actor-critic (Haarnoja et al. 2018); time limits are bootstrapped.

    Subclasses say what the actor sees: :meth:`encode`, :meth:`remember`, :meth:`features`. The hyper-parameters that
    are read here are ``hidden, lr, lr_floor, gamma, tau, temperature, learn_temperature, target_entropy`` and
    ``actor_every`` (:class:`~idapt_pl.modules.policy.AsymmetricSAC` explains them).
    """

    def add_networks(self, actor: Actor, state_dim: int) -> None:
        """The actor, critics to match with their slow copies, and the temperature."""
        self.actor, self.critic = actor, TwinCritic(state_dim, actor, self.hparams.hidden)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor(float(np.log(self.hparams.temperature))))
        self.register_buffer("updates", torch.zeros((), dtype=torch.long))

    # --- acting: what a subclass sees ---------------------------------------------------------------

    @abstractmethod
    def encode(self, observations: np.ndarray) -> Tensor:
        """f(o): features (n, d) of observations as an environment gives them under ``pixels``."""

    @abstractmethod
    def remember(self, observations: np.ndarray) -> dict[str, np.ndarray]:
        """What replay keeps of observations; ``observation`` is what :meth:`features` and :meth:`act_on` take."""

    @abstractmethod
    def features(self, remembered: Tensor) -> Tensor:
        """f(o) (n, d) of what replay keeps, for an update."""

    @abstractmethod
    def act_on(self, remembered: dict[str, np.ndarray]) -> np.ndarray:
        """Sampled actions (n, nu) for what :meth:`remember` returned."""

    def observation_noise(self, num_envs: int, seed: int) -> NoObservationNoise:
        """What becomes of remembered observations on their way to the policy while it trains."""
        return NoObservationNoise()

    def begin(self, n: int) -> Memory | None:
        """What is remembered of n episodes before they begin; None of policies that act on the present alone."""
        return None

    def remembering(self, features: Tensor, memory: Memory | None) -> Tensor:
        """What the actor sees of features f(o) (n, d), with a memory that goes on."""
        return features

    @torch.no_grad()
    def act(self, observations: np.ndarray, deterministic: bool = False) -> np.ndarray:
        """Actions for observations as an environment gives them: (n, ...) to float32 (n, nu)."""
        return self.actor(self.encode(observations), deterministic)[0].cpu().numpy()

    # --- learning -----------------------------------------------------------------------------------

    def training_step(self, batch: dict[str, dict[str, Tensor]], index: int) -> None:
        """One environment step's updates: ``transitions`` are (updates, minibatch, ...)."""
        metrics = self.update(batch)
        for schedule in self.lr_schedulers():
            schedule.step()
        if (index + 1) % self.trainer.log_every_n_steps == 0:  # what nobody writes down costs time
            self.log_at(index, metrics | self.trainer.datamodule.progress())

    def update(self, batch: dict[str, dict[str, Tensor]]) -> dict[str, Tensor]:
        """Critic and actor steps on every minibatch. Returns the metrics of the last one."""
        metrics: dict[str, Tensor] = {}
        minibatches = unstack(batch["transitions"])
        for i, minibatch in enumerate(minibatches, int(self.updates)):
            metrics |= self.critic_step(minibatch)
            if i % self.hparams.actor_every == 0:
                metrics |= self.actor_step(minibatch)
            self.track_critic()
        self.updates += len(minibatches)
        return metrics

    def critic_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress both critics on the soft Bellman target (:func:`~idapt_pl.losses.sac_target`)."""
        with torch.no_grad():
            action, log_prob = self.actor(self.features(batch["next_observation"]))
            next_q = torch.minimum(*self.critic_target(batch["next_state"], action))
            rewards = self.shaped_rewards(batch)
            target = sac_target(
                rewards, batch["terminations"], next_q, log_prob, self.log_alpha.exp(), self.hparams.gamma
            )
        q = self.critic(batch["state"], batch["actions"])
        loss = nnf.mse_loss(q, target.expand_as(q)) * 2
        self.descend(self.optimizers()[0], loss)
        return {"policy/critic_loss": loss.detach(), "policy/q": q.detach()}

    def shaped_rewards(self, batch: dict[str, Tensor]) -> Tensor:
        """The source's rewards as the critics learn them, (n,)."""
        return batch["rewards"]

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Improve the actor on α log π - min Q, and the temperature, in one descent: they share no parameter."""
        action, log_prob = self.actor(self.features(batch["observation"]))
        q = torch.minimum(*self.critic(batch["state"], action, frozen=True))
        alpha = self.log_alpha.exp()
        loss = (alpha.detach() * log_prob - q).mean()
        objective = loss
        if self.hparams.learn_temperature:
            target = self.hparams.target_entropy
            target = -float(action.shape[-1]) if target is None else target
            objective = loss - alpha * (log_prob.detach().mean() + target)
        self.descend(self.optimizers()[1], objective)
        return {
            "policy/actor_loss": loss.detach(),
            "policy/entropy": -log_prob.detach(),
            "policy/temperature": alpha.detach(),
        }

    @torch.no_grad()
    def track_critic(self) -> None:
        """Soft update of the target critics."""
        torch._foreach_lerp_(list(self.critic_target.parameters()), list(self.critic.parameters()), self.hparams.tau)

    def trained_by_the_actor_loss(self) -> list[nn.Parameter]:
        """Parameters that the actor's optimizer moves."""
        return list(self.actor.parameters())

    def configure_optimizers(self) -> tuple[list, list]:
        actor = self.trained_by_the_actor_loss()
        if self.hparams.learn_temperature:
            actor = [*actor, self.log_alpha]
        groups = (self.critic.parameters(), actor)
        optimizers = [torch.optim.Adam(g, lr=self.hparams.lr, fused=True) for g in groups]
        return optimizers, [torch.optim.lr_scheduler.LambdaLR(o, self.linear_decay) for o in optimizers]

    def linear_decay(self, step: int) -> float:
        """Factor on the learning rate after so many batches."""
        return max(self.hparams.lr_floor, 1.0 - self.share_done(step))


def unstack(batch: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """(updates, minibatch, ...) tensors to a list of minibatches."""
    names = list(batch)
    return [dict(zip(names, parts, strict=True)) for parts in zip(*batch.values(), strict=True)]

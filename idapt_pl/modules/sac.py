"""Soft actor-critic, whatever the actor sees: images (:mod:`.policy`) or states (:mod:`.state_policy`)."""

from __future__ import annotations

import copy
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


class Actor(nn.Module):
    """π(a|o): an encoder f of observations and an MLP head, a tanh-squashed Gaussian scaled to the action bounds.

    Args:
        encoder: f; its ``features`` is the size d of f(o).
        action_low: lower bounds (nu,), in the actuators' units.
        action_high: upper bounds (nu,).
        hidden: of the head.
    """

    def __init__(
        self, encoder: nn.Module, action_low: Sequence[float], action_high: Sequence[float], hidden: Sequence[int]
    ) -> None:
        super().__init__()
        low, high = torch.tensor(action_low), torch.tensor(action_high)
        self.encoder = encoder
        self.head = mlp(encoder.features, hidden, 2 * len(low))
        self.head.apply(orthogonal_init)
        self.register_buffer("center", (high + low) / 2)
        self.register_buffer("half_range", (high - low) / 2)

    def forward(self, features: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor]:
        """Action in physical units (n, nu) and its log-probability density on (-1, 1)^nu, (n,), for f(o) (n, d)."""
        normal = self.distribution(features)
        u = normal.mean if deterministic else normal.rsample()
        return self.center + self.half_range * torch.tanh(u), squashed_log_prob(normal.log_prob(u), u)

    def distribution(self, features: Tensor) -> torch.distributions.Normal:
        """What is squashed by tanh and scaled to the bounds, (n, nu)."""
        mean, log_std = self.head(features).float().chunk(2, -1)
        log_std = -5.0 + 3.5 * (1.0 + torch.tanh(log_std))  # in [-5, 2]
        return torch.distributions.Normal(mean, log_std.exp(), validate_args=False)

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
        x = torch.cat([state, (action - self.center) / self.half_range], -1)
        return torch.stack([net(x).squeeze(-1) for net in self.nets])


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
        for minibatch in unstack(batch["transitions"]):
            metrics |= self.critic_step(minibatch)
            if self.updates % self.hparams.actor_every == 0:
                metrics |= self.actor_step(minibatch)
            self.track_critic()
            self.updates += 1
        return metrics

    def critic_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress both critics on the soft Bellman target (:func:`~idapt_pl.losses.sac_target`)."""
        with torch.no_grad():
            action, log_prob = self.actor(self.features(batch["next_observation"]))
            next_q = self.critic_target(batch["next_state"], action).amin(0)
            rewards = self.shaped_rewards(batch)
            target = sac_target(
                rewards, batch["terminations"], next_q, log_prob, self.log_alpha.exp(), self.hparams.gamma
            )
        q = self.critic(batch["state"], batch["actions"])
        loss = nnf.mse_loss(q, target.expand_as(q)) * 2
        self.descend(self.optimizers()[0], loss)
        return {"policy/critic_loss": loss.detach(), "policy/q": q.detach().mean()}

    def shaped_rewards(self, batch: dict[str, Tensor]) -> Tensor:
        """The source's rewards as the critics learn them, (n,)."""
        return batch["rewards"]

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Improve the actor on α log π - min Q, then the temperature."""
        _, opt_actor, opt_alpha = self.optimizers()[:3]
        action, log_prob = self.actor(self.features(batch["observation"]))
        q = self.critic(batch["state"], action).amin(0)
        loss = (self.log_alpha.exp().detach() * log_prob - q).mean()
        self.descend(opt_actor, loss)
        if self.hparams.learn_temperature:
            target = self.hparams.target_entropy
            target = -float(action.shape[-1]) if target is None else target
            self.descend(opt_alpha, -(self.log_alpha.exp() * (log_prob.detach() + target)).mean())
        return {
            "policy/actor_loss": loss.detach(),
            "policy/entropy": -log_prob.detach().mean(),
            "policy/temperature": self.log_alpha.exp().detach(),
        }

    @torch.no_grad()
    def track_critic(self) -> None:
        """Soft update of the target critics."""
        torch._foreach_lerp_(list(self.critic_target.parameters()), list(self.critic.parameters()), self.hparams.tau)

    def trained_by_the_actor_loss(self) -> list[nn.Parameter]:
        """Parameters that the actor's optimizer moves."""
        return list(self.actor.parameters())

    def configure_optimizers(self) -> tuple[list, list]:
        groups = (self.critic.parameters(), self.trained_by_the_actor_loss(), [self.log_alpha])
        optimizers = [torch.optim.Adam(g, lr=self.hparams.lr, fused=True) for g in groups]
        return optimizers, [torch.optim.lr_scheduler.LambdaLR(o, self.linear_decay) for o in optimizers]

    def linear_decay(self, step: int) -> float:
        """Factor on the learning rate after so many batches."""
        return max(self.hparams.lr_floor, 1.0 - self.share_done(step))


def unstack(batch: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """(updates, minibatch, ...) tensors to a list of minibatches."""
    names = list(batch)
    return [dict(zip(names, parts, strict=True)) for parts in zip(*batch.values(), strict=True)]

"""Soft actor-critic, whatever the actor sees: images (:mod:`.policy`) or states (:mod:`.state_policy`)."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.losses import sac_target
from idapt_pl.modules.actor_critic import Actor, TwinCritic
from idapt_pl.modules.lean_adam import LeanAdam
from idapt_pl.modules.manual import ManualModule
from idapt_pl.modules.observation_noise import NoObservationNoise
from idapt_pl.modules.sac_gradients import actor_gradients, critic_gradients
from idapt_pl.nets.state_filter import Memory


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
        if self.heads_alone:
            loss, q = critic_gradients(self.critic, batch["state"], batch["actions"], target)
            self.step(self.optimizers()[0])
        else:
            q = self.critic(batch["state"], batch["actions"])
            loss = nnf.mse_loss(q, target.expand_as(q)) * 2
            self.descend(self.optimizers()[0], loss)
        return {"policy/critic_loss": loss.detach(), "policy/q": q.detach()}

    def shaped_rewards(self, batch: dict[str, Tensor]) -> Tensor:
        """The source's rewards as the critics learn them, (n,)."""
        return batch["rewards"]

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Improve the actor on α log π - min Q, and the temperature, in one descent: they share no parameter."""
        features, alpha, target = self.features(batch["observation"]), self.log_alpha.exp(), self.entropy_wanted
        if self.heads_alone:
            loss, log_prob = actor_gradients(self.actor, self.critic, self.log_alpha, features, batch["state"], target)
            self.step(self.optimizers()[1])
        else:
            action, log_prob = self.actor(features)
            q = torch.minimum(*self.critic(batch["state"], action))
            loss = (alpha.detach() * log_prob - q).mean()
            of_alpha = 0.0 if target is None else alpha * (log_prob.detach().mean() + target)
            self.descend(self.optimizers()[1], loss - of_alpha)
        return {
            "policy/actor_loss": loss.detach(),
            "policy/entropy": -log_prob.detach(),
            "policy/temperature": alpha.detach(),
        }

    @property
    def entropy_wanted(self) -> float | None:
        """What the policy's entropy is kept at by its temperature, nats; None where that stays."""
        wanted = self.hparams.target_entropy
        if not self.hparams.learn_temperature:
            return None
        return -float(len(self.actor.center)) if wanted is None else wanted

    @property
    def heads_alone(self) -> bool:
        """Whether nothing but nets of linear layers learns, in float32: their gradients are written out."""
        return self.plain and next(self.actor.encoder.parameters(), None) is None

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
        optimizers = [LeanAdam(g, lr=self.hparams.lr, fused=True) for g in groups]
        return optimizers, [torch.optim.lr_scheduler.LambdaLR(o, self.linear_decay) for o in optimizers]

    def linear_decay(self, step: int) -> float:
        """Factor on the learning rate after so many batches."""
        return max(self.hparams.lr_floor, 1.0 - self.share_done(step))


def unstack(batch: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """(updates, minibatch, ...) tensors to a list of minibatches."""
    names = list(batch)
    return [dict(zip(names, parts, strict=True)) for parts in zip(*batch.values(), strict=True)]

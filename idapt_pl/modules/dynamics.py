"""The action transformation F: GARAT, i.e. GAIfO with a PPO agent, on features (Section IV-C2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.losses import gail_reward, generalized_advantage, gradient_penalty, ppo_clip
from idapt_pl.modules.manual import ManualModule
from idapt_pl.nets.mlp import mlp
from idapt_pl.nets.units import Units, take_in_units


class ActionTransformation(ManualModule):
    """F(f(o), a^T): the source action whose effect in the source is that of a^T in the target.

    The agent adds δ to the target action; a^S = clip((1-β)·a + β·(a + δ)), β the smoothing (Hanna & Stone
    2017). D tells agent from target transitions (f, a, f'); the agent's reward is -log D. The features f
    are frozen while F is in use: they are a copy kept inside this module.

    Args:
        encoder: f, a module with ``encode(pixels)`` and ``features``; frozen here.
        action_low: lower action bounds; taken from the model.
        action_high: upper action bounds; taken from the model.
        hidden: of F, its value function and D.
        smoothing: β.
        residual_scale: unit of δ, as a multiple of half the action range; nothing but the action bounds limits δ.
        deterministic: F acts with its mean when the policy trains (GARAT); else it samples (the authors' code).
        lr: Adam, agent; decays linearly to zero over a stage.
        lr_discriminator: Adam, D.
        gamma: discount of the imitation reward.
        lam: λ of GAE.
        clip: PPO's ε.
        entropy_weight: of the agent's entropy.
        value_weight: of the value loss.
        epochs: passes over a rollout.
        batch_size: of PPO and of D (as many agent as target transitions).
        discriminator_batches: D updates after each rollout.
        gradient_penalty_weight: of D's one-sided gradient penalty.
        initial_log_std: of the agent, in units of ``residual_scale``.
    """

    def __init__(
        self,
        encoder: nn.Module,
        action_low: list[float],
        action_high: list[float],
        hidden: Sequence[int] = (1024, 1024),
        smoothing: float = 0.95,
        residual_scale: float = 2.0,
        deterministic: bool = True,
        lr: float = 3e-4,
        lr_discriminator: float = 3e-4,
        gamma: float = 0.5,
        lam: float = 0.95,
        clip: float = 0.1,
        entropy_weight: float = 1e-3,
        value_weight: float = 0.5,
        epochs: int = 5,
        batch_size: int = 32,
        discriminator_batches: int = 60,
        gradient_penalty_weight: float = 10.0,
        initial_log_std: float = -1.0,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["encoder"])
        if epochs < 1 or discriminator_batches < 1:
            raise ValueError(
                f"epochs and discriminator_batches must be at least 1, got {epochs}, {discriminator_batches}"
            )
        low, high = torch.tensor(action_low), torch.tensor(action_high)
        d, nu = encoder.features, len(low)
        self.encoder = encoder.requires_grad_(False).eval()
        self.actor = mlp(d + nu, hidden, nu, nn.Tanh)
        self.actor[-1].weight.data.mul_(0.01)  # F starts as the identity
        self.actor[-1].bias.data.zero_()
        self.affine = nn.Linear(d + nu, nu)  # a linear part beside the net, which a start can be given to
        nn.init.zeros_(self.affine.weight)
        nn.init.zeros_(self.affine.bias)
        self.log_std = nn.Parameter(torch.full((nu,), initial_log_std))
        self.value = mlp(d + nu, hidden, 1, nn.Tanh)
        self.D = mlp(2 * d + nu, hidden, 1, nn.Tanh)
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        for name, size in (("feature", d), ("change", d)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    # --- acting -----------------------------------------------------------------------------------

    @torch.no_grad()
    def encode(self, pixels: np.ndarray) -> Tensor:
        """f(o) of observations as an environment gives them, (n, d)."""
        return self.encoder.encode(torch.from_numpy(pixels).to(self.device)).float()

    def agent_input(self, features: Tensor, actions: Tensor) -> Tensor:
        """What F and its value function see: standardised features and the action in -1..1."""
        f = (features - self.feature_mean) / self.feature_std
        return torch.cat([f, self.normalise(actions)], -1)

    def normalise(self, actions: Tensor) -> Tensor:
        """Actions in physical units to -1..1."""
        return (actions - (self.high + self.low) / 2) / ((self.high - self.low) / 2)

    def residual(self, x: Tensor) -> torch.distributions.Normal:
        """Distribution of δ, in units of ``residual_scale`` × half the action range."""
        return torch.distributions.Normal(self.affine(x) + self.actor(x), self.log_std.exp())

    def apply_residual(self, actions: Tensor, delta: Tensor) -> Tensor:
        """a^S = clip((1-β)·a + β·(a + δ)) in physical units."""
        w = self.hparams
        half_range = (self.high - self.low) / 2
        beta = w.smoothing
        transformed = (1 - beta) * actions + beta * (actions + w.residual_scale * half_range * delta)
        return torch.clamp(transformed, self.low, self.high)

    @torch.no_grad()
    def transform(self, pixels: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """F as :class:`~idapt_pl.envs.GroundedEnv` uses it when the policy trains."""
        a = torch.from_numpy(actions).to(self.device)
        distribution = self.residual(self.agent_input(self.encode(pixels), a))
        delta = distribution.mean if self.hparams.deterministic else distribution.sample()
        return self.apply_residual(a, delta).cpu().numpy()

    # --- learning ---------------------------------------------------------------------------------

    def on_fit_start(self) -> None:
        self.standardise(self.trainer.datamodule.target_transitions)

    @torch.no_grad()
    def standardise(self, target: dict[str, Tensor]) -> None:
        """Take mean and spread from the target's transitions. An F that goes on stays the function that it was."""
        d, goes_on = len(self.feature_mean), not self.is_new
        changes = target["next_features"] - target["features"]
        for name, values in (("feature", target["features"]), ("change", changes)):
            mean, std = getattr(self, f"{name}_mean"), getattr(self, f"{name}_std")
            before, now = Units(mean.clone(), std.clone()), Units(values.mean(0), values.std(0).clamp(min=1e-3))
            if goes_on:
                first = slice(0, d) if name == "feature" else slice(-d, None)
                nets = (self.actor[0], self.affine, self.value[0], self.D[0]) if name == "feature" else (self.D[0],)
                for layer in nets:
                    take_in_units(layer.weight[:, first], layer.bias, before, now)
            mean.copy_(now.mean)
            std.copy_(now.std)

    @property
    def is_new(self) -> bool:
        """Whether no data have told the scale of features yet."""
        return bool((self.feature_std == 1).all() and (self.feature_mean == 0).all())

    @torch.no_grad()
    def tell_features_in_units(self, before: Units, now: Units) -> None:
        """The features are standardised otherwise now: the same scales in their new units."""
        ratio = before.std / now.std
        self.feature_mean.mul_(ratio).add_((before.mean - now.mean) / now.std)
        self.change_mean.mul_(ratio)
        for std in (self.feature_std, self.change_std):
            std.mul_(ratio)

    def training_step(self, batch: dict[str, dict[str, Tensor]], index: int) -> None:
        """One rollout: D on agent against target, then PPO on the reward D gives."""
        agent, target = batch["agent"], batch["target"]
        agent_x, target_x = self.transition_input(agent).flatten(0, 1), self.transition_input(target)
        metrics = self.discriminator_steps(agent_x, target_x)
        with torch.no_grad():
            rewards = gail_reward(self.D(self.transition_input(agent)).squeeze(-1))
        metrics |= self.ppo_steps(agent, rewards)
        self.lr_schedulers().step()
        self.log_at(index, metrics)

    def transition_input(self, t: dict[str, Tensor]) -> Tensor:
        """(f, a, f') as D sees it: f' as its standardised change from f, which holds the same information."""
        change = (t["next_features"] - t["features"] - self.change_mean) / self.change_std
        return torch.cat([self.agent_input(t["features"], t["actions"]), change], -1)

    def discriminator_steps(self, agent: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Cross-entropy with label 1 for the agent, 0 for the target, and a gradient penalty."""
        w, opt = self.hparams, self.optimizers()[1]
        for _ in range(w.discriminator_batches):
            a = agent[torch.randint(len(agent), (w.batch_size,), device=agent.device)]
            t = target[torch.randint(len(target), (w.batch_size,), device=agent.device)]
            logit_a, logit_t = self.D(a).squeeze(-1), self.D(t).squeeze(-1)
            bce = nnf.softplus(-logit_a).mean() + nnf.softplus(logit_t).mean()
            penalty = gradient_penalty(self.D, a, t) if w.gradient_penalty_weight else bce.new_zeros(())
            self.descend(opt, bce + w.gradient_penalty_weight * penalty)
        accuracy = 0.5 * ((logit_a > 0).float().mean() + (logit_t < 0).float().mean())
        return {
            "dynamics/d_loss": bce.detach(),
            "dynamics/d_accuracy": accuracy,
            "dynamics/gradient_penalty": penalty.detach(),
        }

    def ppo_steps(self, agent: dict[str, Tensor], rewards: Tensor) -> dict[str, Tensor]:
        """PPO on a rollout of shape (t, n)."""
        w, opt = self.hparams, self.optimizers()[0]
        x = self.agent_input(agent["features"], agent["actions"])
        with torch.no_grad():
            values, next_values = self.value(x).squeeze(-1), self.value(self.next_input(agent)).squeeze(-1)
            advantages = generalized_advantage(
                rewards, values, next_values, torch.zeros_like(agent["ends"]), agent["ends"], w.gamma, w.lam
            )
            old = self.residual(x).log_prob(agent["delta"]).sum(-1).flatten()
        returns = (advantages + values).flatten()
        advantages = advantages.flatten()
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        x, delta = x.flatten(0, 1), agent["delta"].flatten(0, 1)
        for _ in range(w.epochs):
            for rows in torch.randperm(len(x), device=x.device).split(w.batch_size):
                distribution = self.residual(x[rows])
                policy_loss = ppo_clip(distribution.log_prob(delta[rows]).sum(-1), old[rows], advantages[rows], w.clip)
                value_loss = nnf.mse_loss(self.value(x[rows]).squeeze(-1), returns[rows])
                entropy = distribution.entropy().sum(-1).mean()
                self.descend(opt, policy_loss + w.value_weight * value_loss - w.entropy_weight * entropy, clip=0.5)
        return {
            "dynamics/reward": rewards.mean(),
            "dynamics/value_loss": value_loss.detach(),
            "dynamics/entropy": entropy.detach(),
            "dynamics/mean_delta": delta.mean(),
            "dynamics/rms_delta": delta.square().mean().sqrt(),
        }

    def next_input(self, agent: dict[str, Tensor]) -> Tensor:
        """F's input at the successor: its features and the policy's action there."""
        return self.agent_input(agent["next_features"], agent["next_actions"])

    def configure_optimizers(self) -> tuple[list, list]:
        agent = [*self.actor.parameters(), *self.affine.parameters(), self.log_std, *self.value.parameters()]
        optimizers = [
            torch.optim.Adam(agent, lr=self.hparams.lr, fused=True),
            torch.optim.Adam(self.D.parameters(), lr=self.hparams.lr_discriminator, fused=True),
        ]

        def linear(step: int) -> float:  # Table III: linear decay
            return 1.0 - self.share_done(step)

        return optimizers, [torch.optim.lr_scheduler.LambdaLR(optimizers[0], linear)]

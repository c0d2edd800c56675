"""The policy π: asymmetric SAC, an actor that sees images and critics that see states (Section IV-D)."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.losses import sac_target, squashed_log_prob
from idapt_pl.modules.training import ManualModule, fast_precision
from idapt_pl.nets.encoder import PixelEncoder, orthogonal_init
from idapt_pl.nets.mlp import mlp


class ImageActor(nn.Module):
    """π(a|o): encoder f and an MLP head, a tanh-squashed Gaussian scaled to the action bounds."""

    def __init__(
        self, encoder: PixelEncoder, action_low: Sequence[float], action_high: Sequence[float], hidden: Sequence[int]
    ) -> None:
        super().__init__()
        low, high = torch.tensor(action_low), torch.tensor(action_high)
        self.encoder = encoder
        self.head = mlp(encoder.features, hidden, 2 * len(low))
        self.head.apply(orthogonal_init)
        self.register_buffer("center", (high + low) / 2)
        self.register_buffer("half_range", (high - low) / 2)

    def forward(self, features: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor]:
        """Action in physical units (n, nu) and its log-probability density on (-1, 1)^nu, (n,)."""
        mean, log_std = self.head(features).float().chunk(2, -1)
        log_std = -5.0 + 3.5 * (1.0 + torch.tanh(log_std))  # in [-5, 2]
        normal = torch.distributions.Normal(mean, log_std.exp())
        u = mean if deterministic else normal.rsample()
        return self.center + self.half_range * torch.tanh(u), squashed_log_prob(normal.log_prob(u), u)


class TwinCritic(nn.Module):
    """Two Q(s, a) on states, never on images."""

    def __init__(self, state_dim: int, actor: ImageActor, hidden: Sequence[int]) -> None:
        super().__init__()
        inputs = state_dim + len(actor.center)
        self.nets = nn.ModuleList(mlp(inputs, hidden, 1) for _ in range(2))
        self.nets.apply(orthogonal_init)
        self.register_buffer("center", actor.center.clone())
        self.register_buffer("half_range", actor.half_range.clone())

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """Both values, (2, n)."""
        x = torch.cat([state, (action - self.center) / self.half_range], -1)
        return torch.stack([net(x).squeeze(-1) for net in self.nets])


class AsymmetricSAC(ManualModule):
    """Soft actor-critic with an image actor and state critics; time limits are bootstrapped.

    Args:
        state_dim: size of the state vector; taken from the task.
        action_low: lower action bounds; taken from the model.
        action_high: upper action bounds; taken from the model.
        image_size: side of the images, pixels; taken from the data.
        frame_stack: K.
        crop: side of the random crop (training) and centre crop (acting), pixels.
        strides: of the encoder's 4 convolutions.
        hidden: of the actor head and the critics.
        lr: Adam, actor, critics and temperature, decaying linearly to ``lr_floor`` of it over a stage.
        lr_floor: 1 keeps the rate constant.
        gamma: discount.
        tau: soft update of the target critics.
        temperature: α at the start.
        learn_temperature: tune α towards ``target_entropy``; else it stays.
        target_entropy: nats, on actions normalised to (-1, 1); default -nu.
        actor_every: critic updates per actor (and temperature) update.
        bf16: bfloat16 autocast in the encoder.
    """

    def __init__(
        self,
        state_dim: int,
        action_low: list[float],
        action_high: list[float],
        image_size: int,
        frame_stack: int = 3,
        crop: int | None = None,
        strides: Sequence[int] = (2, 1, 1, 1),
        hidden: Sequence[int] = (1024, 1024),
        lr: float = 3e-4,
        lr_floor: float = 1.0,
        gamma: float = 0.99,
        tau: float = 0.01,
        temperature: float = 0.1,
        learn_temperature: bool = True,
        target_entropy: float | None = None,
        actor_every: int = 2,
        bf16: bool = True,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.actor = ImageActor(PixelEncoder(image_size, frame_stack, crop, strides), action_low, action_high, hidden)
        self.critic = TwinCritic(state_dim, self.actor, hidden)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor(float(np.log(temperature))))
        self.register_buffer("updates", torch.zeros((), dtype=torch.long))

    @torch.no_grad()
    def encode(self, pixels: np.ndarray) -> Tensor:
        """f_π(o): features of observations as an environment gives them, (n, d)."""
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(torch.from_numpy(pixels).to(self.device))

    @torch.no_grad()
    def act(self, pixels: np.ndarray, deterministic: bool = False) -> np.ndarray:
        """Actions for observations as an environment gives them: uint8 (n, K, H, W, 3) to float32 (n, nu)."""
        return self.actor(self.encode(pixels), deterministic)[0].cpu().numpy()

    def training_step(self, batch: dict[str, Tensor], index: int) -> None:
        """One environment step's updates: ``batch`` is (updates, minibatch, ...)."""
        metrics: dict[str, Tensor] = {}
        for i in range(len(batch["rewards"])):
            minibatch = {name: value[i] for name, value in batch.items()}
            metrics |= self.critic_step(minibatch)
            if self.updates % self.hparams.actor_every == 0:
                metrics |= self.actor_step(minibatch)
            self.track_critic()
            self.updates += 1
        for schedule in self.lr_schedulers():
            schedule.step()
        self.log_at(index, metrics)

    def features(self, pixels: Tensor) -> Tensor:
        """f(o) of randomly cropped observations."""
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(pixels, augment=True)

    def critic_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress both critics on the soft Bellman target."""
        with torch.no_grad():
            action, log_prob = self.actor(self.features(batch["next_pixels"]))
            next_q = self.critic_target(batch["next_state"], action).amin(0)
            target = sac_target(
                batch["rewards"], batch["terminations"], next_q, log_prob, self.log_alpha.exp(), self.hparams.gamma
            )
        q = self.critic(batch["state"], batch["actions"])
        loss = nnf.mse_loss(q, target.expand_as(q)) * 2
        self.descend(self.optimizers()[0], loss)
        return {"policy/critic_loss": loss.detach(), "policy/q": q.detach().mean()}

    def actor_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Improve the actor on α log π - min Q, then the temperature."""
        _, opt_actor, opt_alpha = self.optimizers()
        action, log_prob = self.actor(self.features(batch["pixels"]))
        self.critic.requires_grad_(False)
        q = self.critic(batch["state"], action).amin(0)
        loss = (self.log_alpha.exp().detach() * log_prob - q).mean()
        self.descend(opt_actor, loss)
        self.critic.requires_grad_(True)
        if self.hparams.learn_temperature:
            target = self.hparams.target_entropy
            target = -float(action.shape[-1]) if target is None else target
            self.descend(opt_alpha, -(self.log_alpha.exp() * (log_prob.detach() + target)).mean())
        return {"policy/actor_loss": loss.detach(), "policy/entropy": -log_prob.detach().mean(),
                "policy/temperature": self.log_alpha.exp().detach()}

    @torch.no_grad()
    def track_critic(self) -> None:
        """Soft update of the target critics."""
        torch._foreach_lerp_(list(self.critic_target.parameters()), list(self.critic.parameters()), self.hparams.tau)

    def configure_optimizers(self) -> tuple[list, list]:
        groups = (self.critic.parameters(), self.actor.parameters(), [self.log_alpha])
        optimizers = [torch.optim.Adam(g, lr=self.hparams.lr, fused=True) for g in groups]
        total, floor = self.trainer.max_epochs * self.trainer.num_training_batches, self.hparams.lr_floor

        def linear(step: int) -> float:
            return max(floor, 1.0 - step / total)

        return optimizers, [torch.optim.lr_scheduler.LambdaLR(o, linear) for o in optimizers]

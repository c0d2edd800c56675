"""The policy π: asymmetric SAC, an actor that sees images and critics that see states (Section IV-D)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from idapt_pl.losses import sac_target, squashed_log_prob
from idapt_pl.modules.manual import ManualModule, fast_precision
from idapt_pl.modules.observation_noise import NoObservationNoise, ObservationNoise
from idapt_pl.modules.visual import VisualTransformation
from idapt_pl.nets.encoder import PixelEncoder, PixelStatePredictor, Vision, orthogonal_init
from idapt_pl.nets.images import jitter, stack_channels
from idapt_pl.nets.mlp import mlp


class ImageActor(nn.Module):
    """π(a|o): encoder f and an MLP head, a tanh-squashed Gaussian scaled to the action bounds."""

    def __init__(
        self,
        encoder: PixelEncoder | PixelStatePredictor,
        action_low: Sequence[float],
        action_high: Sequence[float],
        hidden: Sequence[int],
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
        vision: how images are looked at; the same for all modules.
        rates: state component to the component it is the rate of; taken from the task.
        dt: control period, s; taken from the task.
        hidden: of the actor head and the critics.
        lr: Adam, actor, critics and temperature, decaying linearly to ``lr_floor`` of it over a stage.
        lr_floor: 1 keeps the rate constant.
        gamma: discount.
        tau: soft update of the target critics.
        temperature: α at the start.
        learn_temperature: tune α towards ``target_entropy``; else it stays.
        target_entropy: nats, on actions normalised to (-1, 1); default -nu.
        actor_every: critic updates per actor (and temperature) update.
        encoder: how f is trained. ``learned``: by the actor loss alone (the paper). ``supervised``: f(o) is an
            estimate of the state, regressed on the source's states while the policy trains (asymmetric
            information, as for the critics); replay then keeps f(o), and an update takes a tenth of the time.
        estimator_updates: with ``supervised``, regression steps for each environment step.
        estimator_batch: with ``supervised``, observations in a regression step.
        lr_estimator: with ``supervised``, Adam.
        estimator_jitter: with ``supervised``, how much contrast, brightness and noise of images vary in the regression.
        misperception: with ``supervised``, spread of the gains and offsets (in units of the data's spread) that the
            estimates have while training, new ones in every episode (:class:`~idapt_pl.modules.observation_noise.ObservationNoise`).
        action_cost: taken off the reward while training, times the mean squared action in -1..1. Where a reward does
            not ask for calm actions, policies switch between extremes, which leaves no margin for errors of G and F.
        unfamiliarity_cost: taken off the reward while training, times 1 - exp(-m²/2), m the Mahalanobis distance of the
            state from the source's task-agnostic data. G has learned from such states; far from them, or where their
            components go together differently, its images cannot be relied on.
        bf16: bfloat16 autocast in the encoder, where the device computes in it.
    """

    def __init__(
        self,
        state_dim: int,
        action_low: list[float],
        action_high: list[float],
        image_size: int,
        frame_stack: int = 3,
        vision: Vision = Vision(),
        rates: dict[int, int] | None = None,
        dt: float = 1.0,
        hidden: Sequence[int] = (1024, 1024),
        lr: float = 3e-4,
        lr_floor: float = 1.0,
        gamma: float = 0.99,
        tau: float = 0.01,
        temperature: float = 0.1,
        learn_temperature: bool = True,
        target_entropy: float | None = None,
        actor_every: int = 2,
        encoder: Literal["learned", "supervised"] = "learned",
        estimator_updates: float = 1.0,
        estimator_batch: int = 32,
        lr_estimator: float = 1e-3,
        estimator_jitter: float = 0.0,
        misperception: float = 0.0,
        action_cost: float = 0.0,
        unfamiliarity_cost: float = 0.0,
        bf16: bool = True,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["vision", "rates"])
        f: PixelEncoder | PixelStatePredictor = vision.encoder(image_size, frame_stack)
        if encoder == "supervised":
            f = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)
        self.add_networks(ImageActor(f, action_low, action_high, hidden), state_dim)
        self.register_buffer("familiar_mean", torch.zeros(state_dim))
        self.register_buffer("familiar_precision", torch.eye(state_dim))

    def add_networks(self, actor: ImageActor, state_dim: int) -> None:
        """The actor, critics to match with their slow copies, and the temperature."""
        self.actor, self.critic = actor, TwinCritic(state_dim, actor, self.hparams.hidden)
        self.critic_target = copy.deepcopy(self.critic).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor(float(np.log(self.hparams.temperature))))
        self.register_buffer("updates", torch.zeros((), dtype=torch.long))

    def know(self, states: Tensor) -> None:
        """Take what is familiar from the states (n, state_dim) of the source's task-agnostic data."""
        self.familiar_mean.copy_(states.mean(0))
        self.familiar_precision.copy_(torch.linalg.pinv(torch.atleast_2d(states.T.cov()), hermitian=True))

    def start_from(self, predictor: PixelStatePredictor) -> None:
        """With a supervised encoder, start it as a copy of a fitted state predictor."""
        if self.hparams.encoder == "supervised":
            self.actor.encoder.load_state_dict(predictor.state_dict())

    def estimator(self, G: VisualTransformation) -> PixelStatePredictor:
        """What estimates states from target images: the supervised encoder, else P^T."""
        return self.actor.encoder if self.hparams.encoder == "supervised" else G.P_T

    @torch.no_grad()
    def encode(self, pixels: np.ndarray) -> Tensor:
        """f_π(o): features of observations as an environment gives them, (n, d)."""
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(torch.from_numpy(pixels).to(self.device))

    @torch.no_grad()
    def act(self, pixels: np.ndarray, deterministic: bool = False) -> np.ndarray:
        """Actions for observations as an environment gives them: uint8 (n, K, H, W, 3) to float32 (n, nu)."""
        return self.actor(self.encode(pixels), deterministic)[0].cpu().numpy()

    def remember(self, pixels: np.ndarray) -> dict[str, np.ndarray]:
        """What replay keeps of observations: images, or f(o) as ``observation`` with the images beside it."""
        if self.hparams.encoder == "learned":
            return {"observation": pixels}
        return {"observation": self.encode(pixels).cpu().numpy(), "pixels": pixels}

    def perception(self, num_envs: int, seed: int) -> NoObservationNoise:
        """What becomes of f(o) on its way to the policy while it trains in ``num_envs`` simulations."""
        if self.hparams.encoder == "learned" or not self.hparams.misperception:
            return NoObservationNoise()
        return ObservationNoise(self.actor.encoder, num_envs, self.hparams.misperception, seed)

    @torch.no_grad()
    def act_on(self, remembered: dict[str, np.ndarray]) -> np.ndarray:
        """Sampled actions for what :meth:`remember` returned."""
        seen = remembered["observation"]
        features = self.encode(seen) if self.hparams.encoder == "learned" else torch.from_numpy(seen).to(self.device)
        return self.actor(features)[0].cpu().numpy()

    def training_step(self, batch: dict[str, dict[str, Tensor]], index: int) -> None:
        """One environment step's updates: ``transitions`` and ``images`` are (updates, minibatch, ...)."""
        metrics: dict[str, Tensor] = {}
        for minibatch in unstack(batch["transitions"]):
            metrics |= self.critic_step(minibatch)
            if self.updates % self.hparams.actor_every == 0:
                metrics |= self.actor_step(minibatch)
            self.track_critic()
            self.updates += 1
        for minibatch in unstack(batch.get("images", {})):
            metrics |= self.estimator_step(minibatch)
        for schedule in self.lr_schedulers():
            schedule.step()
        if (index + 1) % self.trainer.log_every_n_steps == 0:  # what nobody writes down costs time
            self.log_at(index, metrics | self.trainer.datamodule.progress())

    def estimator_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress f(o) on the source state."""
        loss = self.estimator_loss(batch)
        self.descend(self.optimizers()[3], loss)
        return {"policy/state_error": loss.detach()}

    def estimator_loss(self, batch: dict[str, Tensor]) -> Tensor:
        """L1 between f(o) of a batch's ``pixels`` and its standardised ``state``."""
        with fast_precision(self.device, self.hparams.bf16):
            images = jitter(stack_channels(batch["pixels"]), self.hparams.estimator_jitter)
            return self.actor.encoder.error(images, batch["state"])

    def features(self, remembered: Tensor) -> Tensor:
        """f(o) of what replay keeps; images are cropped at random."""
        if remembered.dtype != torch.uint8:
            return remembered
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(remembered, augment=True)

    def critic_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress both critics on the soft Bellman target."""
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
        """The source's rewards less what actions and unfamiliar states cost, (n,)."""
        effort = self.actor.normalise(batch["actions"]).square().mean(-1)
        off = batch["next_state"] - self.familiar_mean
        unfamiliarity = 1 - torch.exp(-0.5 * torch.einsum("ni,ij,nj->n", off, self.familiar_precision, off))
        w = self.hparams
        return batch["rewards"] - w.action_cost * effort - w.unfamiliarity_cost * unfamiliarity

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

    def configure_optimizers(self) -> tuple[list, list]:
        supervised = self.hparams.encoder == "supervised"
        actor = self.actor.head.parameters() if supervised else self.actor.parameters()
        groups = (self.critic.parameters(), actor, [self.log_alpha])
        optimizers = [torch.optim.Adam(g, lr=self.hparams.lr, fused=True) for g in groups]
        if supervised and self.hparams.estimator_updates:
            optimizers.append(
                torch.optim.Adam(self.actor.encoder.parameters(), lr=self.hparams.lr_estimator, fused=True)
            )

        def linear(step: int) -> float:
            return max(self.hparams.lr_floor, 1.0 - self.share_done(step))

        return optimizers, [torch.optim.lr_scheduler.LambdaLR(o, linear) for o in optimizers]


def unstack(batch: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """(updates, minibatch, ...) tensors to a list of minibatches."""
    names = list(batch)
    return [dict(zip(names, parts, strict=True)) for parts in zip(*batch.values(), strict=True)]

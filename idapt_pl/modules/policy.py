"""The policy π: asymmetric SAC, an actor that sees images and critics that see states (Section IV-D)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from idapt_pl.modules.actor_critic import Actor
from idapt_pl.modules.manual import fast_precision
from idapt_pl.modules.observation_noise import Flicker, NoObservationNoise, ObservationNoise, Several
from idapt_pl.modules.sac import SAC, unstack
from idapt_pl.modules.visual import VisualTransformation
from idapt_pl.nets.encoder import PixelEncoder, PixelStatePredictor, Vision
from idapt_pl.nets.images import relight, stack_channels
from idapt_pl.nets.state_filter import Memory, StateFilter


class AsymmetricSAC(SAC):
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
        misperception: with ``supervised``, spread of the gains and offsets (in units of the data's spread) that the
            estimates have while training, new ones in every episode (:class:`.ObservationNoise`).
        flicker: with ``supervised``, standard deviation (in units of the data's spread) of a noise that every image's
            estimates have of their own, while training and in trials (:class:`.Flicker`).
        relight: with ``supervised``, how much the light of images varies while the encoder learns from them
            (:func:`~idapt_pl.nets.images.relight`): G gives the target's usual light, and the target has others.
        action_cost: taken off the reward while training, times the mean squared action in -1..1. Where a reward does
            not ask for calm actions, policies switch between extremes, which leaves no margin for errors of G and F.
        memory: with ``supervised``, size of the memory of a filter over time (:class:`.StateFilter`), which stands
            between the encoder and the actor's head; 0 for none (the paper).
        recurrent: size of LSTMs in actor and critics, trained by SAC itself (:class:`.RecurrentSAC`, Adaptive RL); 0
            for none. For ``method: source``.
        sequence: with ``recurrent``, transitions in a stretch that updates are on (the paper: 7).
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
        misperception: float = 0.0,
        flicker: float = 0.0,
        relight: float = 0.0,
        action_cost: float = 0.0,
        unfamiliarity_cost: float = 0.0,
        memory: int = 0,
        recurrent: int = 0,
        sequence: int = 7,
        bf16: bool = True,
    ) -> None:
        super().__init__()
        if memory and encoder != "supervised":
            raise ValueError(
                f"memory is {memory}, but encoder is {encoder}: a filter needs readings of states. Set one"
            )
        self.save_hyperparameters(ignore=["vision", "rates"])
        f: PixelEncoder | PixelStatePredictor = vision.encoder(image_size, frame_stack)
        if encoder == "supervised":
            f = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)
        self.add_networks(self.make_actor(f, action_low, action_high, hidden), state_dim)
        self.filter = StateFilter(state_dim, len(action_low), memory) if memory else None
        self.register_buffer("familiar_mean", torch.zeros(state_dim))
        self.register_buffer("familiar_precision", torch.eye(state_dim))

    def make_actor(self, f: nn.Module, low: list[float], high: list[float], hidden: Sequence[int]) -> Actor:
        """The actor with encoder f."""
        return Actor(f, low, high, hidden)

    def set_familiar_states(self, states: Tensor) -> None:
        """Take what is familiar from the states (n, state_dim) of the source's task-agnostic data."""
        self.familiar_mean.copy_(states.mean(0))
        self.familiar_precision.copy_(torch.linalg.pinv(torch.atleast_2d(states.T.cov()), hermitian=True))

    def start_from(self, predictor: PixelStatePredictor) -> None:
        """With a supervised encoder, start it as a copy of a fitted state predictor."""
        if self.supervised:
            self.actor.encoder.load_state_dict(predictor.state_dict())

    def estimator(self, G: VisualTransformation) -> PixelStatePredictor:
        """What estimates states from target images: the supervised encoder, else P^T."""
        return self.actor.encoder if self.supervised else G.estimator

    @torch.no_grad()
    def encode(self, pixels: np.ndarray) -> Tensor:
        """f_π(o): features of observations as an environment gives them, (n, d)."""
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(torch.from_numpy(pixels).to(self.device))

    def begin(self, n: int) -> Memory | None:
        return self.filter.begin(n) if self.filter is not None else None

    def remembering(self, features: Tensor, memory: Memory | None) -> Tensor:
        """The filter's estimates (n, s) of readings f(o) (n, s); without a filter the readings."""
        if self.filter is None or memory is None:
            return features
        return self.filter.step(features, memory)

    def remember(self, pixels: np.ndarray) -> dict[str, np.ndarray]:
        """What replay keeps of observations: images, or f(o) as ``observation`` with the images beside it."""
        if self.hparams.encoder == "learned":
            return {"observation": pixels}
        return {"observation": self.encode(pixels).cpu().numpy(), "pixels": pixels}

    def observation_noise(self, num_envs: int, seed: int) -> NoObservationNoise:
        """What becomes of f(o) on its way to the policy while it trains in ``num_envs`` simulations."""
        if not self.supervised or not self.hparams.misperception:
            return self.flicker(num_envs, seed)
        wrong = ObservationNoise(self.actor.encoder, num_envs, self.hparams.misperception, seed)
        return Several(wrong, self.flicker(num_envs, seed)) if self.hparams.flicker else wrong

    def flicker(self, num_envs: int, seed: int) -> NoObservationNoise:
        """The part of it that changes from image to image, which trials have too."""
        if not self.supervised or not self.hparams.flicker:
            return NoObservationNoise()
        return Flicker(self.actor.encoder, num_envs, self.hparams.flicker, seed, self.hparams.frame_stack)

    @torch.no_grad()
    def act_on(self, remembered: dict[str, np.ndarray]) -> np.ndarray:
        """Sampled actions for what :meth:`remember` returned."""
        seen = remembered["observation"]
        features = self.encode(seen) if self.hparams.encoder == "learned" else torch.from_numpy(seen).to(self.device)
        return self.actor(features)[0].cpu().numpy()

    def update(self, batch: dict[str, dict[str, Tensor]]) -> dict[str, Tensor]:
        """As of SAC; then the supervised encoder's updates on ``images``, (updates, minibatch, ...)."""
        metrics = super().update(batch)
        for minibatch in unstack(batch.get("images", {})):
            metrics |= self.estimator_step(minibatch)
        return metrics

    def estimator_step(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """Regress f(o) on the source state."""
        loss = self.estimator_loss(batch)
        self.descend(self.optimizers()[-1], loss)
        return {"policy/state_error": loss.detach()}

    def estimator_loss(self, batch: dict[str, Tensor]) -> Tensor:
        """L1 between f(o) of a batch's ``pixels`` and its standardised ``state``."""
        with fast_precision(self.device, self.hparams.bf16):
            images = relight(stack_channels(batch["pixels"]), self.hparams.relight)
            return self.actor.encoder.error(images, batch["state"])

    def features(self, remembered: Tensor) -> Tensor:
        """f(o) of what replay keeps; images are cropped at random."""
        if remembered.dtype != torch.uint8:
            return remembered
        with fast_precision(self.device, self.hparams.bf16):
            return self.actor.encoder.encode(remembered, augment=True)

    def shaped_rewards(self, batch: dict[str, Tensor]) -> Tensor:
        """The source's rewards less what actions and unfamiliar states cost, (n,)."""
        rewards, w = batch["rewards"], self.hparams
        if w.action_cost:
            rewards = rewards - w.action_cost * self.actor.normalise(batch["actions"]).square().mean(-1)
        if w.unfamiliarity_cost:
            off = batch["next_state"] - self.familiar_mean
            distance = torch.einsum("ni,ij,nj->n", off, self.familiar_precision, off)
            rewards = rewards - w.unfamiliarity_cost * (1 - torch.exp(-0.5 * distance))
        return rewards

    @property
    def supervised(self) -> bool:
        """Whether f(o) is regressed on the source's states."""
        return self.hparams.encoder == "supervised"

    @property
    def heads_alone(self) -> bool:
        return self.supervised and self.plain

    def trained_by_the_actor_loss(self) -> list[nn.Parameter]:
        return list((self.actor.head if self.supervised else self.actor).parameters())

    def configure_optimizers(self) -> tuple[list, list]:
        optimizers, schedules = super().configure_optimizers()
        if self.supervised and self.hparams.estimator_updates:
            encoder = torch.optim.Adam(self.actor.encoder.parameters(), lr=self.hparams.lr_estimator, fused=True)
            optimizers.append(encoder)
            schedules.append(torch.optim.lr_scheduler.LambdaLR(encoder, self.linear_decay))
        return optimizers, schedules

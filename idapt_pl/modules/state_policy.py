"""SAC on states: experts for datasets, and the bounds that transfer is measured against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from idapt_pl.modules.actor_critic import Actor
from idapt_pl.modules.observation_noise import MixedNoise, NoObservationNoise, RecordedErrors, SlowNoise
from idapt_pl.modules.sac import SAC


class Standardise(nn.Module):
    """States to about zero mean and unit spread; what lies far outside the data is cut off at ten."""

    def __init__(self, state_dim: int) -> None:
        super().__init__()
        self.features = state_dim
        self.register_buffer("mean", torch.zeros(state_dim))
        self.register_buffer("std", torch.ones(state_dim))

    def fit(self, states: Tensor) -> None:
        """Take mean and spread from (n, state_dim); a component that hardly varies keeps its units."""
        std = states.std(0)
        self.mean.copy_(states.mean(0))
        self.std.copy_(torch.where(std > 1e-5, std, torch.ones_like(std)))

    def forward(self, states: Tensor) -> Tensor:
        """Standardised states."""
        return ((states - self.mean) / self.std).clamp(-10, 10)


class StateSAC(SAC):
    """Soft actor-critic whose actor sees the state too, standardised; so do its critics.

    Args:
        state_dim: size of the state vector.
        action_low: lower action bounds, in the actuators' units.
        action_high: upper action bounds.
        hidden: of the actor and the critics.
        lr: Adam, decaying linearly to ``lr_floor`` of it over a stage.
        lr_floor: 1 keeps the rate constant.
        gamma: discount.
        tau: soft update of the target critics.
        temperature: α at the start.
        learn_temperature: tune α towards ``target_entropy``; else it stays.
        target_entropy: nats, on actions normalised to (-1, 1); default -nu.
        actor_every: critic updates per actor (and temperature) update.
        noise: spread of slow noise on the states that the actor sees while it trains, in units of their spread.
        offset: spread of errors that stay for a whole episode, likewise.
    """

    def __init__(
        self,
        state_dim: int,
        action_low: list[float],
        action_high: list[float],
        hidden: Sequence[int] = (256, 256),
        lr: float = 1e-3,
        lr_floor: float = 0.1,
        gamma: float = 0.99,
        tau: float = 0.01,
        temperature: float = 0.1,
        learn_temperature: bool = True,
        target_entropy: float | None = None,
        actor_every: int = 1,
        noise: float = 0.0,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.add_networks(Actor(Standardise(state_dim), action_low, action_high, hidden), state_dim)
        self.recorded_errors: Sequence[np.ndarray] = ()
        """Errors (T, s) of whole episodes that the actor has to bear while it trains, in place of noise."""

    @torch.no_grad()
    def encode(self, observations: np.ndarray) -> Tensor:
        """Standardised states of states (n, state_dim)."""
        return self.actor.encoder(torch.from_numpy(observations).to(self.device))

    def remember(self, observations: np.ndarray) -> dict[str, np.ndarray]:
        return {"observation": observations}

    @torch.no_grad()
    def act_on(self, remembered: dict[str, np.ndarray]) -> np.ndarray:
        return self.act(remembered["observation"])

    def observation_noise(self, num_envs: int, seed: int) -> NoObservationNoise:
        noises: list[NoObservationNoise] = []
        if len(self.recorded_errors):
            noises.append(RecordedErrors(self.recorded_errors, num_envs, seed))
        if self.hparams.noise or self.hparams.offset:
            scale = self.actor.encoder.std.cpu().numpy()
            noises.append(SlowNoise(scale, num_envs, self.hparams.noise, self.hparams.offset, seed))
        if len(noises) == 2:  # errors measured in one world alone, and a teacher forgets to bear others
            return MixedNoise(noises, num_envs, seed)
        return noises[0] if noises else NoObservationNoise()

    @property
    def misled(self) -> bool:
        """Whether the actor does not see the true states while it trains."""
        return bool(self.hparams.noise or self.hparams.offset or len(self.recorded_errors))

    def features(self, remembered: Tensor) -> Tensor:
        return remembered  # standardised by update()

    def update(self, batch: dict[str, dict[str, Tensor]]) -> dict[str, Tensor]:
        """As of SAC, on standardised states: all minibatches of a step at once."""
        return super().update({**batch, "transitions": self.standardised(batch["transitions"])})

    def standardised(self, transitions: dict[str, Tensor]) -> dict[str, Tensor]:
        """What actor and critics see of transitions."""
        names = ("state", "next_state", *(("observation", "next_observation") if self.misled else ()))
        seen = {name: self.actor.encoder(transitions[name]) for name in names}
        if not self.misled:
            seen |= {"observation": seen["state"], "next_observation": seen["next_state"]}
        return transitions | seen

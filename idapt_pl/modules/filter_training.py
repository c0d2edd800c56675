"""How a policy's filter learns the state from readings over time, where true states are known."""

from __future__ import annotations

import lightning as L
import torch
from jaxtyping import Float
from torch import Tensor

from idapt_pl.modules.policy import AsymmetricSAC
from idapt_pl.modules.state_predictor import annealed_adam
from idapt_pl.nets.state_filter import StateFilter

LAST_BATCHES = 20
"""What a filter usually corrects is taken from so many batches."""


class FilterTraining(L.LightningModule):
    """Fits a policy's filter to true states with an L1 loss on stretches of readings and actions.

    Readings of the grounded source are not wrong in quite the way those of the target are. So each stretch has a gain
    and an offset for each component, noise, and readings that do not come (domain randomisation, on readings).

    Args:
        policy: whose filter learns; all else stays.
        lr: Adam, annealed to zero.
        gain: spread of the gains around 1.
        offset: spread of the offsets, in units of the data's spread.
        noise: spread of what is new in every reading, in those units.
        dropout: share of the readings in place of which the last one stands.
    """

    def __init__(
        self,
        policy: AsymmetricSAC,
        lr: float = 1e-3,
        gain: float = 0.15,
        offset: float = 0.15,
        noise: float = 0.1,
        dropout: float = 0.02,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["policy"])
        self.policy = policy
        self._corrections: list[Tensor] = []

    @property
    def filter(self) -> StateFilter:
        """The one that learns."""
        assert self.policy.filter is not None  # policy.memory is above 0
        return self.policy.filter

    def on_train_start(self) -> None:
        self.filter.train()  # finished policies are in evaluation mode, in which cuDNN gives a GRU no gradients

    def training_step(self, batch: dict[str, Tensor], index: int) -> Tensor:
        """``readings`` and ``states`` (b, t, s), ``actions`` before each (b, t, nu), -1..1; ``there``, bool (b, t)."""
        readings = disturbed(batch["readings"], self.hparams)
        hidden = readings.new_zeros(len(readings), self.filter.hidden)
        estimates, _ = self.filter(readings, batch["actions"], hidden)
        there = batch["there"]
        error = (estimates - batch["states"]).abs()[there].mean()
        of_readings = (batch["readings"] - batch["states"]).abs()[there].mean()
        self.log_dict({"filter/error": error, "filter/error_of_readings": of_readings}, prog_bar=True)
        if index >= self.trainer.num_training_batches - LAST_BATCHES:
            self._corrections.append((readings - estimates).detach()[there])
        return error

    def on_train_end(self) -> None:
        self.filter.learn_usual_correction(torch.cat(self._corrections))
        self._corrections.clear()

    def configure_optimizers(self) -> dict:
        steps = int(self.trainer.estimated_stepping_batches)
        optimizer, schedule = annealed_adam(self.filter.parameters(), self.hparams.lr, steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def disturbed(readings: Float[Tensor, "b t s"], how: dict) -> Float[Tensor, "b t s"]:
    """Readings with random gains and offsets for each stretch, noise, and some that did not come (``how``)."""
    b, t, s = readings.shape
    gain = 1 + how["gain"] * torch.randn(b, 1, s, device=readings.device)
    offset = how["offset"] * torch.randn(b, 1, s, device=readings.device)
    noisy = readings * gain + offset + how["noise"] * torch.randn_like(readings)
    came = torch.rand(b, t, device=readings.device) >= how["dropout"]
    came[:, 0] = True
    newest = torch.where(came, torch.arange(t, device=readings.device), 0).cummax(1).values  # (b, t)
    return noisy.gather(1, newest[..., None].expand(-1, -1, s))

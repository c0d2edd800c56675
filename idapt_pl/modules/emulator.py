"""Emulated perception: what the encoder makes of translated images, predicted from the source's state."""

from __future__ import annotations

from collections.abc import Sequence

import lightning as L
import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.nets.mlp import mlp


class PerceptionEmulator(L.LightningModule):
    """s^S -> f(G(o^S)), fitted to translated frames; the rest of f's reading is Gaussian noise.

    Rendering, G and f are a function of the source's state alone. Predicting it lets F and the policy
    train at the speed of physics; the images stay what the policy acts on everywhere else.

    Args:
        f: the encoder, a state predictor; kept inside, frozen.
        state_dim: size of the state vector.
        glimpses: frames in a stack, K.
        hidden: of the MLP.
        noise: added to every glimpse besides, in units of the states' spread. The target is seen less sharply
            than the grounded source; without noise, policies rely on finer readings than the target gives.
        margin: how far beyond the states it was fitted on an emulation is trusted, as a share of their range.
        lr: Adam.
    """

    def __init__(
        self,
        f: PixelStatePredictor,
        state_dim: int,
        glimpses: int = 3,
        hidden: Sequence[int] = (128, 128),
        noise: float = 0.0,
        margin: float = 0.05,
        lr: float = 3e-3,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["f"])
        self.f = f.requires_grad_(False).eval()
        self.glimpses = glimpses if f.rates else 1
        self.inputs = list(f.shown) if f.rates else list(range(state_dim))
        self.net = mlp(len(self.inputs), hidden, len(f.shown), torch.nn.Tanh)
        for name in ("low", "high"):
            self.register_buffer(name, torch.zeros(len(self.inputs)))
        self.register_buffer("spread", torch.zeros(len(f.shown)))  # of what is not predicted

    def forward(self, states: Tensor) -> Tensor:
        """Glimpse of states (n, state_dim): the state itself plus what perception adds to it, (n, m)."""
        seen = self.f.standardise(states)[:, self.inputs]
        return seen + self.net(seen)

    def training_step(self, batch: list[Tensor], _: int) -> Tensor:
        states, glimpses = batch
        loss = nnf.mse_loss(self(states), glimpses)
        self.log("emulator/rms_error", loss.detach().sqrt(), prog_bar=True)
        return loss

    def on_fit_start(self) -> None:
        states = self.trainer.datamodule.states[:, self.inputs]
        self.low.copy_(states.amin(0))
        self.high.copy_(states.amax(0))

    @torch.no_grad()
    def on_fit_end(self) -> None:
        data = self.trainer.datamodule
        error = self(data.states.to(self.device)) - data.glimpses.to(self.device)
        self.spread.copy_(error.std(0))

    @torch.no_grad()
    def glimpse(self, states: np.ndarray) -> np.ndarray:
        """A noisy glimpse of each state, (n, m)."""
        x = self(torch.from_numpy(states).to(self.device))
        spread = torch.hypot(self.spread, torch.full_like(self.spread, self.hparams.noise))
        return (x + spread * torch.randn_like(x)).cpu().numpy()

    def combine(self, glimpses: np.ndarray) -> np.ndarray:
        """Features of a stack of glimpses, (n, K, m) to (n, d)."""
        return self.f.combine(torch.from_numpy(glimpses).to(self.device)).cpu().numpy()

    def covers(self, states: np.ndarray) -> np.ndarray:
        """Whether states lie within what was fitted, give or take the margin."""
        x = torch.from_numpy(states).to(self.device)[:, self.inputs]
        slack = self.hparams.margin * (self.high - self.low)
        return ((x >= self.low - slack) & (x <= self.high + slack)).all(-1).cpu().numpy()

    def configure_optimizers(self) -> dict:
        optimizer = torch.optim.Adam(self.net.parameters(), lr=self.hparams.lr, fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, int(self.trainer.estimated_stepping_batches))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

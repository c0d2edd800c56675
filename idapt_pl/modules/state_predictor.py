"""P^S: the source state from source images, supervised (Section IV-C1)."""

from __future__ import annotations

import lightning as L
import torch
from torch import Tensor

from idapt_pl.modules.manual import fast_precision
from idapt_pl.nets.encoder import Vision
from idapt_pl.nets.images import stack_channels


class StatePredictor(L.LightningModule):
    """Fits P^S to (images, states) of the source with an L1 loss on standardised states.

    Args:
        state_dim: size of the state vector; taken from the task.
        image_size: side of the images, pixels; taken from the data.
        frame_stack: K.
        vision: how images are looked at; the same for all modules.
        rates: state component to the component it is the rate of; taken from the task.
        dt: control period, s; taken from the task.
        lr: Adam.
        bf16: bfloat16 autocast, where the device computes in it.
    """

    def __init__(
        self,
        state_dim: int,
        image_size: int,
        frame_stack: int = 3,
        vision: Vision = Vision(),
        rates: dict[int, int] | None = None,
        dt: float = 1.0,
        lr: float = 3e-4,
        bf16: bool = True,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["vision", "rates"])
        self.P_S = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)

    def on_fit_start(self) -> None:
        self.P_S.fit_scale(torch.from_numpy(self.trainer.datamodule.data.labels))

    def training_step(self, batch: dict[str, Tensor], _: int) -> Tensor:
        with fast_precision(self.device, self.hparams.bf16):
            error = self.P_S.error(stack_channels(batch["pixels"]), batch["state"])
        self.log("state_predictor/l1", error, prog_bar=True)
        return error

    def configure_optimizers(self) -> dict:
        optimizer = torch.optim.Adam(self.parameters(), lr=self.hparams.lr, fused=True)
        steps = int(self.trainer.estimated_stepping_batches)
        # Annealed to zero: the last predictions are what everything after this is anchored to.
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

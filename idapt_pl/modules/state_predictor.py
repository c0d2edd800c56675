"""P^S: the source state from source images, supervised (Section IV-C1)."""

from __future__ import annotations

from collections.abc import Iterable

import lightning as L
import torch
from torch import Tensor, nn
from torch.utils.data import Dataset

from idapt_pl.modules.manual import fast_precision
from idapt_pl.nets.encoder import PixelStatePredictor, Vision
from idapt_pl.nets.images import relight, stack_channels


class StatePredictor(L.LightningModule):
    """Fits P^S to (images, states) of the source with an L1 loss on standardised states; NaN are left out.

    Args:
        state_dim: size of the state vector; taken from the task.
        image_size: side of the images, pixels; taken from the data.
        frame_stack: K.
        vision: how images are looked at; the same for all modules.
        rates: state component to the component it is the rate of; taken from the task.
        dt: control period, s; taken from the task.
        lr: Adam.
        bf16: bfloat16 autocast, where the device computes in it.
        relight: how much the light of images varies while it learns (:func:`~idapt_pl.nets.images.relight`).
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
        relight: float = 0.0,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["vision", "rates"])
        self.P_S = vision.predictor(image_size, frame_stack, state_dim, rates or {}, dt)

    def on_fit_start(self) -> None:
        states = torch.from_numpy(self.trainer.datamodule.data.labels)
        self.P_S.fit_scale(states[~states.isnan().any(1)])

    def training_step(self, batch: dict[str, Tensor], _: int) -> Tensor:
        with fast_precision(self.device, self.hparams.bf16):
            images = relight(stack_channels(batch["pixels"]), self.hparams.relight)
            error = self.P_S.error(images, batch["state"])
        self.log("state_predictor/l1", error, prog_bar=True)
        return error

    def configure_optimizers(self) -> dict:
        steps = int(self.trainer.estimated_stepping_batches)
        optimizer, schedule = annealed_adam(self.parameters(), self.hparams.lr, steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def annealed_adam(
    parameters: Iterable[nn.Parameter], lr: float, steps: int
) -> tuple[torch.optim.Adam, torch.optim.lr_scheduler.CosineAnnealingLR]:
    """How a P is fitted: Adam, annealed to zero, as the last predictions anchor everything after them."""
    optimizer = torch.optim.Adam(parameters, lr=lr, fused=True)
    return optimizer, torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps))


def fit_state_predictor(
    predictor: PixelStatePredictor, data: Dataset, batches: int, batch_size: int, lr: float, device: torch.device
) -> PixelStatePredictor:
    """Fit a P as :class:`StatePredictor` does, inside of another Trainer's fit, where no second Trainer can run.

    Args:
        predictor: as it was made; its scale is taken from the data.
        data: with ``labels`` (n, s), and batches of ``pixels`` and ``state`` by ``__getitems__``.
        batches: gradient steps.
        batch_size: stacks in each.
        lr: the first learning rate.
        device: to fit on; the predictor comes back on the CPU.
    """
    predictor.fit_scale(torch.from_numpy(data.labels))
    predictor.to(device).train()
    optimizer, schedule = annealed_adam(predictor.parameters(), lr, batches)
    for _ in range(batches):
        batch = data.__getitems__(torch.randint(len(data), (batch_size,)).tolist())
        error = predictor.error(stack_channels(batch["pixels"].to(device)), batch["state"].to(device))
        optimizer.zero_grad(set_to_none=True)
        error.backward()
        optimizer.step()
        schedule.step()
    return predictor.cpu().eval()

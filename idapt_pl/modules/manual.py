"""What the LightningModules share: one descent step, mixed precision, the run's x axis."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import lightning as L
import torch
from torch import Tensor


class ManualModule(L.LightningModule):
    """A module that steps its own optimizers (several nets trained in turn).

    Metrics are logged against ``step`` rather than Lightning's ``global_step``, which counts every
    optimizer's steps together.
    """

    def __init__(self) -> None:
        super().__init__()
        self.automatic_optimization = False

    def descend(self, optimizer: torch.optim.Optimizer, loss: Tensor, clip: float | None = None) -> None:
        """Zero gradients, backpropagate to the optimizer's parameters alone, clip the norm if asked to, step."""
        optimizer.zero_grad(set_to_none=True)
        own = [p for group in optimizer.param_groups for p in group["params"] if p.requires_grad]
        self.manual_backward(loss, inputs=own)
        if clip is not None:
            self.clip_gradients(optimizer, gradient_clip_val=clip, gradient_clip_algorithm="norm")
        optimizer.step()

    def share_done(self, step: int) -> float:
        """Share of the stage that ``step`` batches are, for learning rates.

        Read at every step: while optimizers are configured the Trainer has not seen the data yet, and says infinity.
        """
        return step / (self.trainer.max_epochs * self.trainer.num_training_batches)

    def log_at(self, step: float, metrics: dict[str, Tensor | float]) -> None:
        """Log scalars with ``step`` as the x axis."""
        self.log_dict(
            {k: v.detach() if isinstance(v, Tensor) else float(v) for k, v in metrics.items()}, prog_bar=False
        )
        self.log("step", float(step), prog_bar=False)


def computes_bfloat16(device: torch.device | str) -> bool:
    """Whether a device has instructions for bfloat16.

    CPUs without (all with AVX2 only) convolve it in a loop that is ten times as slow as float32.
    """
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if torch.device(device).type != "cpu" or not torch.backends.mkldnn.is_available():
        return False
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def fast_precision(device: torch.device, enabled: bool) -> AbstractContextManager:
    """bfloat16 autocast for convolutions, where the device computes in it; the nets return float32.

    Otherwise the Trainer's precision stands.
    """
    if enabled and computes_bfloat16(device):
        return torch.autocast(device.type, torch.bfloat16)
    return nullcontext()

"""What the LightningModules share: one descent step, mixed precision, the run's x axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TypeAlias, TypeVar

import lightning as L
import torch
from torch import Tensor

from idapt_pl.cores import at_once
from idapt_pl.modules.lean_adam import LeanAdam

Made = TypeVar("Made")
Losses: TypeAlias = tuple[Made, dict[str, Tensor]]
"""Something that was made, and losses on it by name."""


class ManualModule(L.LightningModule):
    """A module that steps its own optimizers (several nets trained in turn).

    Metrics are logged against ``step`` rather than Lightning's ``global_step``, which counts every
    optimizer's steps together.
    """

    two_ways: bool | None = None
    """Whether two parts are computed at once, where there are two (:class:`~idapt_pl.cores.FreeCores` says)."""

    def __init__(self) -> None:
        super().__init__()
        self.automatic_optimization = False

    @property
    def plain(self) -> bool:
        """Whether a step is just backpropagation and the optimizer's: one device, float32.

        Lightning's own way round is then left out, as it takes a twentieth of SAC's time.
        """
        trainer = self._trainer
        return trainer is not None and trainer.world_size == 1 and trainer.precision == "32-true"

    def descend(self, optimizer: torch.optim.Optimizer, loss: Tensor, clip: float | None = None) -> None:
        """Zero gradients, backpropagate to the optimizer's parameters alone, clip the norm if asked to, step."""
        optimizer.zero_grad(set_to_none=True)
        own = [p for group in optimizer.param_groups for p in group["params"] if p.requires_grad]
        if self.plain:
            loss.backward(inputs=own)
        else:
            self.manual_backward(loss, inputs=own)
        if clip is not None:
            self.clip_gradients(optimizer, gradient_clip_val=clip, gradient_clip_algorithm="norm")
        self.step(optimizer)

    def step(self, optimizer: torch.optim.Optimizer) -> None:
        """A step of an optimizer whose parameters have gradients."""
        plain = getattr(optimizer, "optimizer", optimizer) if self.plain else optimizer
        plain.update() if isinstance(plain, LeanAdam) else plain.step()

    def descend_each(
        self, optimizer: torch.optim.Optimizer, makers: Sequence[Callable[[], Losses]], bf16: bool = False
    ) -> list[Losses]:
        """A step on the sum of all losses, each maker's backpropagated as soon as it is made; two of them at once.

        Gradients of two add up to the same bits in either order, so nothing depends on how they are scheduled.

        Args:
            optimizer: its gradients are zeroed before.
            makers: each returns something and its losses by name.
            bf16: bfloat16 autocast, where the device computes in it.

        Returns:
            What the makers returned, losses detached.
        """
        optimizer.zero_grad(set_to_none=True)
        own = [p for group in optimizer.param_groups for p in group["params"] if p.requires_grad]
        at_a_time = bool(self.two_ways) and len(makers) == 2

        def run(make: Callable[[], Losses]) -> Losses:
            with fast_precision(self.device, bf16, cache=False):  # the cache is shared between threads
                made, losses = make()
            loss = torch.stack(list(losses.values())).sum()
            if at_a_time:
                loss.backward(inputs=own)  # Lightning's hooks are not for two threads, and do nothing on a CPU
            else:
                self.manual_backward(loss, inputs=own)
            return made, {name: loss.detach() for name, loss in losses.items()}

        results = list(at_once(*(partial(run, make) for make in makers))) if at_a_time else [*map(run, makers)]
        optimizer.step()
        return results

    def share_done(self, step: int) -> float:
        """Share of the stage that ``step`` batches are, for learning rates.

        Read at every step: while optimizers are configured the Trainer has not seen the data yet, and says infinity.
        """
        return step / (self.trainer.max_epochs * self.trainer.num_training_batches)

    def log_at(self, step: float, metrics: dict[str, Tensor | float]) -> None:
        """Log scalars, of tensors their means, with ``step`` as the x axis."""
        self.log_dict(
            {k: v.detach().float().mean() if isinstance(v, Tensor) else float(v) for k, v in metrics.items()},
            prog_bar=False,
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


def fast_precision(device: torch.device, enabled: bool, cache: bool = True) -> AbstractContextManager:
    """bfloat16 autocast for convolutions, where the device computes in it; the nets return float32.

    Otherwise the Trainer's precision stands. With a ``cache`` weights are converted once for several uses.
    """
    if enabled and computes_bfloat16(device):
        return torch.autocast(device.type, torch.bfloat16, cache_enabled=cache)
    return nullcontext()

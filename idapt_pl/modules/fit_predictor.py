"""Small networks fitted on the spot: P^S of the standalone visual transformation, and probes for evaluation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.data import Dataset

from idapt_pl.nets.encoder import PixelStatePredictor
from idapt_pl.nets.images import stack_channels


def fit_state_predictor(
    predictor: PixelStatePredictor, data: Dataset, batches: int, batch_size: int, lr: float, device: torch.device
) -> PixelStatePredictor:
    """Fit P to labelled frame stacks: L1 on standardised states, Adam, learning rate annealed to zero.

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
    optimizer = torch.optim.Adam(predictor.parameters(), lr=lr, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, batches))
    for _ in range(batches):
        batch = data.__getitems__(torch.randint(len(data), (batch_size,)).tolist())
        error: Tensor = predictor.error(stack_channels(batch["pixels"].to(device)), batch["state"].to(device))
        optimizer.zero_grad(set_to_none=True)
        error.backward()
        optimizer.step()
        schedule.step()
    return predictor.cpu().eval()

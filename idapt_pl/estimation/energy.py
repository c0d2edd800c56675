"""Energy distance between samples and energy score of forecasts."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def energy_distance(x: Tensor, y: Tensor) -> float:
    """2 E|X-Y| - E|X-X'| - E|Y-Y'|, zero iff the distributions agree (Székely & Rizzo 2013, eq. 2)."""

    def within(z: Tensor) -> float:
        return float(torch.cdist(z, z).sum() / (len(z) * (len(z) - 1)))

    return 2 * float(torch.cdist(x, y).mean()) - within(x) - within(y)


def energy_score(members: np.ndarray, observed: np.ndarray) -> float:
    """E|X - y| - ½ E|X - X'|, mean over time but for the first moment (Gneiting & Raftery 2007, eq. 21).

    Proper: no other forecast has a lower expectation than the distribution that y is of.

    Args:
        members: X, (m, T+1, d) with m > 1.
        observed: y, (T+1, d).
    """
    m = len(members)
    off = np.linalg.norm(members - observed, axis=-1).mean(0)
    apart = np.linalg.norm(members[:, None] - members[None], axis=-1).sum((0, 1)) / (m * (m - 1))
    return float((off - 0.5 * apart)[1:].mean())

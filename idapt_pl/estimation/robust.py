"""Spread by medians, which a minority of wild values does not move."""

from __future__ import annotations

import numpy as np


def robust_deviation(errors: np.ndarray) -> np.ndarray:
    """Standard deviation about 0 of normal errors, over the first axis, by the median of their sizes.

    Args:
        errors: (N, ...), up to half of them wild.

    Returns:
        (...), in the errors' unit.
    """
    return 1.4826 * np.median(np.abs(errors), 0)

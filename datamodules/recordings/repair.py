"""Repair of a recording's times: single rows whose time repeats or goes back are left out."""

from __future__ import annotations

import numpy as np


def rows_to_drop(times: np.ndarray) -> list[int]:
    """Rows without which times increase, in their order.

    A row is dropped where the time after it is again beyond the time before it; or where it is itself beyond both
    rows after it, as one single time that is far too large is. What is wrong in several rows one after another, such
    as a clock that was set back or a second recording, stays as it is.

    Args:
        times: of the rows (T+1,), in any unit.
    """
    drop: list[int] = []
    last = len(times) - 1
    slips = [int(k) + 1 for k in np.flatnonzero(np.diff(times) <= 0)]
    beside = set(slips)
    for k in slips:
        if k - 1 in beside:  # several in a row are no single slip
            continue
        if k == last or times[k + 1] > times[k - 1]:
            drop.append(k)
        elif times[k - 1] > times[k] and times[k + 1] > times[k] and (k < 2 or times[k] > times[k - 2]):
            drop.append(k - 1)
    return drop

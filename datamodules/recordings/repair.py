"""Repair of a recording: rows without numbers are left out, and single rows whose time repeats or goes back."""

from __future__ import annotations

import numpy as np

from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded, is_number


def empty_rows(recorded: Recorded, mapping: Mapping) -> np.ndarray:
    """Which rows (T+1,) lack a number that the map needs: a time, position, velocity or command.

    Args:
        recorded: an episode.
        mapping: with one column for each channel.
    """
    measured = [c for joint in mapping.joints.values() for c in (joint.position, joint.velocity) if c is not None]
    columns = [column for channel in measured for column in channel.columns]
    counted = [*columns, *([mapping.images.column] if mapping.images else [])]
    rows = max((len(recorded.columns[c]) for c in counted if c in recorded.columns), default=0)
    empty = np.zeros(rows, bool)
    for column in [*columns, *([mapping.time[0]] if mapping.time else [])]:
        empty[: len(recorded.columns.get(column, ()))] |= _no_numbers(recorded, column)[:rows]
    acts = slice(None, -1) if mapping.actions_at == "start" else slice(1, None)  # the row of commands too many
    for channel in mapping.actuators.values():
        for column in channel.columns:
            lacking = _no_numbers(recorded, column)
            empty[acts] |= lacking[acts] if len(lacking) == rows else np.resize(lacking, max(rows - 1, 0))
    return empty


def _no_numbers(recorded: Recorded, column: str) -> np.ndarray:
    """Which rows of a column hold no finite number; none where there is no such column, which is told elsewhere."""
    values = recorded.columns.get(column, np.zeros(0))
    if values.dtype.kind not in "fiub":
        values = np.array([float(v) if is_number(v) else np.nan for v in values])
    return ~np.isfinite(values)


def between_empty(recorded: Recorded, empty: np.ndarray) -> list[Recorded]:
    """The stretches of two rows and more that lack nothing, as episodes of their own.

    Args:
        recorded: an episode of T+1 rows.
        empty: which of these lack a number, (T+1,).
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[True], empty, [True]]).astype(int)))
    stretches = zip(edges[::2], edges[1::2], strict=True)
    return [recorded.rows(int(a), int(b), len(empty)) for a, b in stretches if b - a > 1]


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

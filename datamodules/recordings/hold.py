"""Channels that were logged at other rates than the rest, as a table that joins several topics has them.

A row is one with a value of a channel that is not held. From every held channel it has the latest value at or before
it, as a held command has; rows before the first value of a held channel are dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datamodules.recordings.alternatives import chosen
from datamodules.recordings.errors import RecordingError
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded


def with_held_channels(episodes: list[Recorded], mapping: Mapping) -> tuple[list[Recorded], tuple[str, ...]]:
    """Episodes whose held channels have a value in every row, and what to tell of it.

    Raises:
        RecordingError: naming the file and column, if a held channel has no value at all.
    """
    if not any(channel.hold for channel in mapping.channels):
        return episodes, ()
    joined, lost = [], 0
    for episode in episodes:
        channels = chosen(mapping, episode).channels
        held, own = (
            [name for c in channels if c.hold == hold for name in c.columns if name in episode.columns]
            for hold in (True, False)  # a column that is missing is told elsewhere
        )
        joined.append(with_held_columns(episode, held, own))
        lost += _rows(episode, held + own) - _rows(joined[-1], held + own)
    note = f"{lost} rows are left out that have held channels alone, or come before the first value of one"
    return joined, (note,) if lost else ()


def _rows(recorded: Recorded, names: Sequence[str]) -> int:
    return max((len(recorded.columns[name]) for name in names), default=0)


def with_held_columns(recorded: Recorded, held: Sequence[str], own: Sequence[str]) -> Recorded:
    """An episode whose held columns have a value in every row.

    Args:
        recorded: the episode.
        held: columns in whose empty cells the last value holds.
        own: the columns that make the rows: where all of them are empty there is none.

    Raises:
        RecordingError: naming the column, if it is empty.
    """
    columns = dict(recorded.columns)
    rows = _rows(recorded, [*held, *own])
    drop = np.zeros(rows, bool)
    for name in held:
        values = columns[name]
        latest = np.maximum.accumulate(np.where(empty_cells(values), -1, np.arange(len(values))))
        if (latest < 0).all():
            raise RecordingError(f"{recorded.source}: column {name!r} is empty, and the map holds its last value")
        drop[: len(latest)] |= latest < 0
        columns[name] = values[np.maximum(latest, 0)]
    if whole := [empty_cells(columns[name]) for name in own if len(columns[name]) == rows]:
        drop |= np.all(whole, axis=0)
    return replace(recorded, columns=columns).without(np.flatnonzero(drop).tolist(), rows)


def empty_cells(values: np.ndarray) -> np.ndarray:
    """Which cells of a column (rows,) hold nothing, or NaN; another text is no empty cell."""
    if values.dtype.kind in "iub":
        return np.zeros(len(values), bool)
    if values.dtype.kind == "f":
        return np.isnan(values)
    return np.array([str(cell).strip().lower() in ("", "nan", "none") for cell in values], bool)

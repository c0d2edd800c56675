"""Topics with their own clocks, put on the rows of one of them: what all formats with topics share.

A row is a message of the clock topic. From every other topic it has the latest message at or before that
time, as a held command has; rows before the first message of some topic that the map names are dropped, and those
after a stream that stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datamodules.recordings.clocks import end_of_rows
from datamodules.recordings.errors import RecordingError, choices, listing
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.recorded import Recorded

IMAGE = "(image)"
"""Column of a topic that is its images."""
LOG_TIME = "log_time"
"""Column that every topic has: when a message was logged, ns."""
SURVEYED = 2000
"""So many messages of each topic are looked at where no map says what is wanted."""


@dataclass(frozen=True)
class Topic:
    """Messages of a topic in the order of their log times.

    Attributes:
        times: log times (messages,), ns.
        columns: field to array (messages,), or images uint8 (messages, S, S, 3).
    """

    times: np.ndarray
    columns: dict[str, np.ndarray] = field(repr=False)


ReadTopics = Callable[[list[str], ImageColumn | None, int | None], dict[str, Topic]]
"""Reads the named topics; of one the images, if asked for; so many messages of each, None: all."""


def read_log(path: Path, names: Iterable[str], mapping: Mapping, read: ReadTopics) -> list[Recorded]:
    """A log of several topics as one episode, columns ``<topic>.<field>``.

    Args:
        path: of the log, for messages.
        names: topics that have messages.
        mapping: which columns are wanted; if it names none, the topics stay as they are, each with its own rows.
        read: reads topics.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    names = sorted(set(names))
    if not names:
        raise RecordingError(f"{path}: is empty; expected messages")
    if mapping.survey:
        surveyed = read(names, None, SURVEYED)
        return [Recorded(str(path), {f"{t}.{k}": a for t, topic in surveyed.items() for k, a in topic.columns.items()})]
    wanted = _wanted_topics(path, names, mapping)
    topics = read(wanted, mapping.images, None)
    alone = mapping.images if not mapping.joints else None
    clock = mapping.clock or (alone.column if alone else wanted[0])  # the first column's
    if clock not in topics:
        raise RecordingError(f"{path}: the map's clock: no topic {clock!r}; " + choices(clock, topics, "topics are"))
    end, notes = end_of_rows(path, clock, {name: topic.times for name, topic in topics.items()})
    return [Recorded(str(path), _on_rows_of(clock, topics, end), notes=notes)]


def topics_in(columns: Iterable[str]) -> list[str]:
    """The topics that columns are of; none for a format without topics."""
    return [name.removesuffix(f".{LOG_TIME}") for name in columns if name.endswith(f".{LOG_TIME}")]


def _wanted_topics(path: Path, names: list[str], mapping: Mapping) -> list[str]:
    """Topics that the map's columns come from, in its order."""
    topics: dict[str, None] = {}
    for columns in mapping.wanted():
        found = [t for column in columns if (t := topic_of(column, names)) is not None]
        if not found:
            raise RecordingError(
                f"{path}: column {' or '.join(map(repr, columns))} is of no topic in it; expected <topic>.<field>, "
                f"topics are: {listing(names)}"
            )
        topics |= dict.fromkeys(found)
    images = mapping.images
    if images is not None:
        if images.column not in names:
            told = choices(images.column, names, "topics are")
            raise RecordingError(f"{path}: images.column: no topic {images.column!r}; {told}")
        topics |= {images.column: None}
    return list(topics)


def topic_of(column: str, topics: Iterable[str]) -> str | None:
    """The longest topic that a column's name begins with."""
    return max((t for t in topics if column.startswith(f"{t}.")), key=len, default=None)


def _on_rows_of(clock: str, topics: dict[str, Topic], end: int | None) -> dict[str, np.ndarray]:
    """Columns on the clock's messages, up to a time in ns."""
    at = topics[clock].times
    latest = {name: np.searchsorted(topic.times, at, side="right") - 1 for name, topic in topics.items()}
    latest[clock] = np.arange(len(at))
    keep = np.all([k >= 0 for k in latest.values()], axis=0)
    if end is not None:
        keep &= at <= end
    return {
        name if column == IMAGE else f"{name}.{column}": values[latest[name][keep]] if len(values) else values
        for name, topic in topics.items()
        for column, values in topic.columns.items()
    }

"""ULog files, which PX4 writes: topics of columns, each with its own times."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.recordings.errors import RecordingError, expect_magic, optional
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.topics import LOG_TIME, Topic, read_log

ULOG_MAGIC = b"ULog\x01\x12\x35"
MOST_FIELDS, DEEPEST = 20_000, 20
"""Fields of a message, and formats within formats; a log of a vehicle has hundreds, and two or three."""
LATEST_TIME = 2**63 // 1000
"""Microseconds; a later time does not fit into 64 bits as nanoseconds."""


def read_ulog(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a file as one episode: columns ``<topic>.<field>``, such as ``vehicle_attitude.q[0]``.

    The second instance of a topic is ``<topic>.1``. Every topic has ``timestamp`` in µs and ``log_time``, the same
    in ns.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    pyulog = optional("pyulog", "pyulog", path)
    expect_magic(path, ULOG_MAGIC, "ULog file of PX4")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # pyulog prints what it thinks of a damaged file
            _check_formats(path, pyulog.ULog(str(path), parse_header_only=True).message_formats)
            log = pyulog.ULog(str(path))
    except RecordingError:
        raise
    except Exception as error:  # it raises what it likes on bytes that it cannot read
        told = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise RecordingError(f"{path}: not a readable ULog file (truncated or damaged): {told}") from None
    if log.file_corruption:
        raise RecordingError(
            f"{path}: the ULog file is damaged: some of its messages are not readable; copy it from the autopilot "
            "again, or cut out the sound part"
        )
    datasets = [data for data in log.data_list if "timestamp" in data.data and len(data.data["timestamp"])]
    names = [_name(data) for data in datasets]

    def read(topics: list[str], images: ImageColumn | None, most: int | None) -> dict[str, Topic]:
        if images is not None:
            raise RecordingError(f"{path}: images.column: ULog files hold no images")
        return {
            topic: _topic(path, topic, [d for d, name in zip(datasets, names, strict=True) if name == topic], most)
            for topic in topics
        }

    return read_log(path, names, mapping, read)


def _check_formats(path: Path, formats: dict[str, Any]) -> None:
    """Refuse formats that contain each other, or so many of another that their fields have no end."""
    fields: dict[str, int] = {}

    def count(name: str, within: tuple[str, ...] = ()) -> int:
        if name in within or len(within) > DEEPEST:
            raise RecordingError(f"{path}: the ULog format {name!r} is part of itself or nested too deeply")
        if name not in fields:
            parts = formats[name].fields if name in formats else None
            inner = (max(size, 1) * count(kind, (*within, name)) for kind, size, _ in parts or ())
            fields[name] = 1 if parts is None else sum(inner)
        if fields[name] > MOST_FIELDS:
            raise RecordingError(f"{path}: the ULog format {name!r} has {fields[name]} fields; at most {MOST_FIELDS}")
        return fields[name]

    for name in formats:
        count(name)


def _name(data: Any) -> str:
    return f"{data.name}.{data.multi_id}" if data.multi_id else str(data.name)


def _topic(path: Path, name: str, datasets: list[Any], most: int | None) -> Topic:
    """A topic's messages; one that was subscribed to again lies in several data sets."""
    shared = [field for field in datasets[0].data if all(field in d.data for d in datasets)]
    columns = {field: np.concatenate([d.data[field] for d in datasets]) for field in shared}
    stamps = columns["timestamp"]
    if stamps.dtype.kind not in "iu" or int(stamps.max()) > LATEST_TIME:
        raise RecordingError(f"{path}: topic {name}: timestamp holds {stamps.max()}, expected microseconds")
    order = np.argsort(stamps, kind="stable")[:most]
    columns = {field: values[order] for field, values in columns.items()}
    times = columns["timestamp"].astype(np.int64) * 1000
    return Topic(times, {LOG_TIME: times} | columns)

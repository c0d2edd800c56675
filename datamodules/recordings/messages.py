"""Messages of ROS, protobuf or JSON as flat fields, and a topic's messages as columns."""

from __future__ import annotations

import base64
import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from datamodules.recordings.errors import RecordingError, listing
from datamodules.recordings.frames import decoded_image, fitted_frames, raw_image
from datamodules.recordings.mapping import ImageColumn
from datamodules.recordings.recorded import is_number
from datamodules.recordings.topics import IMAGE, LOG_TIME, Topic

LONGEST_LIST = 256
"""A longer list in a message is an image or a scan and is left out."""
LOOKED_AT = 200_000
"""So many messages of a log are looked at where only some of each topic are wanted."""


@dataclass(frozen=True)
class Message:
    """A message before it is decoded.

    Attributes:
        topic: that it is of.
        times: ``log_time`` and what other times the log has, ns.
        decode: makes an object, dict or ROS message of it, or raises a RecordingError.
    """

    topic: str
    times: dict[str, int]
    decode: Callable[[], Any]


def decode_message(path: object, name: str, kind: str, time: int, decoder: Callable[[bytes], Any], data: bytes) -> Any:
    """A message of a topic and a type, logged at a time in ns; what the decoder raises names them."""
    try:
        return decoder(data)
    except RecordingError:
        raise
    except Exception as error:  # the decoder raises what it likes on bytes that it cannot read
        told = "it is compressed" if data.startswith(b"\x28\xb5\x2f\xfd") else f"{type(error).__name__}: {error}"[:200]
        raise RecordingError(
            f"{path}: a message of topic {name} at log time {time} ns cannot be decoded as {kind}: {told}"
        ) from None


def collect_topics(
    path: object, messages: Iterable[Message], names: list[str], images: ImageColumn | None, most: int | None
) -> dict[str, Topic]:
    """Decode messages and put those of each topic into columns.

    Args:
        path: of the log, for messages.
        messages: in any order.
        names: topics, in the order in which they are returned.
        images: the topic whose images are wanted, and their size.
        most: so many messages of each topic, of which a topic that cannot be decoded is left out; None: all.

    Raises:
        RecordingError: naming the file and the message that cannot be decoded.
    """
    flat: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    left_out: set[str] = set()
    for seen, message in enumerate(messages):
        if most is not None and seen >= LOOKED_AT:
            break
        rows = flat.get(message.topic)
        if rows is None or message.topic in left_out or (most is not None and len(rows) >= most):
            continue
        try:
            decoded = message.decode()
        except RecordingError:
            if most is None:
                raise
            left_out.add(message.topic)
            continue
        row = dict(message.times) | flatten(decoded)
        if images is not None and message.topic == images.column:
            where = f"{path}: topic {message.topic} at log time {message.times[LOG_TIME]} ns"
            row[IMAGE] = fitted_frames([_image(decoded, where)], images.size)[0]
        rows.append(row)
    return {name: _as_topic(rows) for name, rows in flat.items()}


def _as_topic(rows: list[dict[str, Any]]) -> Topic:
    rows = sorted(rows, key=lambda row: row[LOG_TIME])
    return Topic(np.array([row[LOG_TIME] for row in rows], dtype=np.int64), as_columns(rows))


def as_columns(rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Flattened messages as columns (rows,) of numbers or text; what a message does not have is NaN."""
    cells: dict[str, dict[int, Any]] = defaultdict(dict)
    for k, row in enumerate(rows):
        for name, value in row.items():
            cells[name][k] = value
    return {name: _column([at.get(k, np.nan) for k in range(len(rows))]) for name, at in cells.items()}


def _column(values: list) -> np.ndarray:
    """Numbers; where one is text, texts as objects, of which a long one does not make all the others long."""
    if any(isinstance(value, str) for value in values):
        return np.array([str(value) for value in values], dtype=object)
    array = np.array(values)
    return array if array.dtype.kind in "fiub" else np.array([_float(value) for value in values])


def _float(value: Any) -> float:
    """A number too large for 64 bits as it can be held; JSON has such."""
    try:
        return float(value)
    except OverflowError:
        return np.inf


def _image(message: Any, where: str) -> np.ndarray:
    """The image uint8 (h, w, 3) of a message."""
    fields = _fields(message) or {}
    data: Any = fields.get("data")
    try:
        data = base64.b64decode(data) if isinstance(data, str) else bytes(data) if hasattr(data, "__len__") else b""
    except (TypeError, ValueError):
        data = b""
    if not data:
        raise RecordingError(f"{where}: expected an image's bytes in data; fields are: {listing(fields)}")
    if {"height", "width", "step", "encoding"} <= fields.keys():
        height, width, step = (int(fields[name]) for name in ("height", "width", "step"))
        return raw_image(data, height, width, step, str(fields["encoding"]), where)
    return decoded_image(data, where)


def flatten(message: Any, name: str = "") -> dict[str, Any]:
    """Numbers and texts of a nested message by dotted names; a time stamp becomes one number of ns."""
    fields = _fields(message)
    if fields is not None:
        if (stamp := _stamp(fields)) is not None:
            return {name: stamp}
        flat: dict[str, Any] = {}
        labels = fields.get("name")
        for key, value in fields.items():
            flat |= _labelled(f"{name}.{key}" if name else str(key), value, None if key == "name" else labels)
        return flat
    if isinstance(message, (bool, int, float, str, np.number)):
        return {name: message}
    return _labelled(name, message, None) if hasattr(message, "__len__") else {}  # a message may have no fields


def _labelled(name: str, value: Any, labels: Any) -> dict[str, Any]:
    """Elements of a list by number and, as in a ROS JointState, by the names that lie beside it."""
    if isinstance(value, (str, bytes, bytearray)) or _fields(value) is not None or not hasattr(value, "__len__"):
        return {} if isinstance(value, (bytes, bytearray)) or value is None else flatten(value, name)
    if len(value) > LONGEST_LIST:
        return {}
    flat = {}
    named = not isinstance(labels, str) and hasattr(labels, "__len__") and len(labels) == len(value)
    for i, element in enumerate(value):
        if named and isinstance(element, (int, float, np.number)):
            flat[f"{name}[{labels[i]}]"] = element
        flat |= _labelled(f"{name}[{i}]", element, None)
    return flat


def _fields(message: Any) -> dict[str, Any] | None:
    """Fields of a message by name: JSON object, protobuf message or decoded ROS message; None for a value."""
    if isinstance(message, dict):
        return message
    if dataclasses.is_dataclass(message):
        names = [field.name for field in dataclasses.fields(message) if not field.name.startswith("_")]
        return {name: getattr(message, name) for name in names}
    if (descriptor := getattr(message, "DESCRIPTOR", None)) is not None:
        return {field.name: getattr(message, field.name) for field in descriptor.fields}
    slots = getattr(type(message), "__slots__", ())
    if slots and not isinstance(message, (str, bytes, np.generic)) and not hasattr(message, "__len__"):
        return {slot: getattr(message, slot, None) for slot in slots if not slot.startswith("_")}
    return None


def _stamp(fields: dict[str, Any]) -> int | None:
    """Nanoseconds of a time stamp of ROS or protobuf, None for another message."""
    for seconds, nanoseconds in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        if set(fields) == {seconds, nanoseconds} and all(map(is_number, fields.values())):
            return int(fields[seconds]) * 10**9 + int(fields[nanoseconds])
    return None

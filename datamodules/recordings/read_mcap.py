"""MCAP files: messages of several topics, each with its own times, put on the rows of one of them.

A row is a message of the clock topic. From every other topic it has the latest message at or before that
time, as a held command has; rows before the first message of some topic that the map names are dropped.
"""

from __future__ import annotations

import base64
import importlib
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from datamodules.recordings.errors import RecordingError, choices, listing, optional
from datamodules.recordings.frames import decoded_image, fitted_frames, raw_image
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.recorded import Recorded, is_number

LONGEST_LIST = 256
"""A longer list in a message is an image or a scan and is left out."""

IMAGE = "(image)"
"""Field of a flattened message that is its image."""

DECODERS = {"mcap_ros2.decoder": "mcap-ros2-support", "mcap_protobuf.decoder": "mcap-protobuf-support"}


def read_mcap(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a file as one episode: columns ``<topic>.<field>``, such as ``/joint_states.position[elbow]``.

    Every topic also has ``<topic>.log_time`` and ``<topic>.publish_time`` in ns. Images are a topic's: ROS's ``Image``
    or ``CompressedImage``, or what else has a picture's bytes in ``data``.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    optional("mcap", "mcap", path)
    from mcap.exceptions import McapError

    try:
        with path.open("rb") as f:
            topics = _read_topics(path, f, list(mapping.columns()), mapping.images)
    except (McapError, EOFError) as error:
        raise RecordingError(f"{path}: not a readable MCAP file (truncated or of another kind): {error!r}") from None
    clock = mapping.clock or next(iter(topics))  # the first column's
    if clock not in topics:
        raise RecordingError(f"{path}: the map's clock: no topic {clock!r}; " + choices(clock, topics, "topics are"))
    return [Recorded(str(path), _on_rows_of(clock, topics))]


def _read_topics(
    path: Path, f: BinaryIO, wanted: list[str], images: ImageColumn | None
) -> dict[str, list[dict[str, Any]]]:
    """Flattened messages, in order of log time, of the topics that the wanted columns come from, in their order."""
    from mcap.reader import make_reader

    reader = make_reader(f)
    factories = [JsonDecoder(), *_decoder_factories()]
    names = _topic_names(reader)
    if not names:
        raise RecordingError(f"{path}: is empty; expected messages")
    topics: dict[str, list[dict[str, Any]]] = {}
    for column in wanted:
        if (topic := _topic_of(column, names)) is None:
            raise RecordingError(
                f"{path}: column {column!r} is of no topic in it; expected <topic>.<field>, topics are: "
                + listing(sorted(names))
            )
        topics[topic] = []
    if images is not None:
        if images.column not in names:
            told = choices(images.column, names, "topics are")
            raise RecordingError(f"{path}: images.column: no topic {images.column!r}; {told}")
        topics.setdefault(images.column, [])
    for schema, channel, message in reader.iter_messages(topics=list(topics)):
        flat = {"log_time": message.log_time, "publish_time": message.publish_time}
        decoded = _decode(path, factories, schema, channel, message)
        flat |= _flatten(decoded)
        if images is not None and channel.topic == images.column:
            where = f"{path}: topic {channel.topic} at log time {message.log_time} ns"
            flat[IMAGE] = fitted_frames([_image(decoded, where)], images.size)[0]
        topics[channel.topic].append(flat)
    return topics


def _topic_names(reader: Any) -> set[str]:
    """Topics with messages; a recording that was cut short has no summary, so its messages are walked."""
    summary = reader.get_summary()
    if summary is not None and summary.channels:
        return {channel.topic for channel in summary.channels.values()}
    return {channel.topic for _, channel, _ in reader.iter_messages()}


def _topic_of(column: str, topics: Iterable[str]) -> str | None:
    """The longest topic that a column's name begins with."""
    return max((t for t in topics if column.startswith(f"{t}.")), key=len, default=None)


class JsonDecoder:
    """Messages that are JSON, in the shape that mcap expects of a decoder factory."""

    def decoder_for(self, message_encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
        """The decoder, if this is JSON."""
        return json.loads if message_encoding == "json" else None


def _decoder_factories() -> Iterator:
    """Those of the message encodings that are installed."""
    for module in DECODERS:
        try:
            yield importlib.import_module(module).DecoderFactory()
        except ImportError:
            continue


def _decode(path: Path, factories: list, schema: Any, channel: Any, message: Any) -> Any:
    for factory in factories:
        if decoder := factory.decoder_for(channel.message_encoding, schema):
            try:
                return decoder(message.data)
            except Exception as error:  # decoders raise what they like on bytes they cannot read
                raise RecordingError(
                    f"{path}: a message of topic {channel.topic} at log time {message.log_time} ns cannot be decoded "
                    f"as {channel.message_encoding}: {error}"
                ) from None
    raise RecordingError(
        f"{path}: topic {channel.topic} is encoded as {channel.message_encoding!r}, for which no decoder is "
        f'installed; json needs none, ROS 2 (cdr) and protobuf do: pip install "idapt[import]" '
        f"({listing(DECODERS.values())})"
    )


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


# --- a message as flat fields ---------------------------------------------------------------------------


def _flatten(message: Any, name: str = "") -> dict[str, Any]:
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
    return _labelled(name, message, None)


def _labelled(name: str, value: Any, labels: Any) -> dict[str, Any]:
    """Elements of a list by number and, as in a ROS JointState, by the names that lie beside it."""
    if isinstance(value, (str, bytes, bytearray)) or _fields(value) is not None or not hasattr(value, "__len__"):
        return {} if isinstance(value, (bytes, bytearray)) or value is None else _flatten(value, name)
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
    """Fields of a message by name: JSON object, protobuf message or decoded ROS 2 message; None for a value."""
    if isinstance(message, dict):
        return message
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


# --- topics on common rows ------------------------------------------------------------------------------


def _on_rows_of(clock: str, topics: dict[str, list[dict[str, Any]]]) -> dict[str, np.ndarray]:
    times = {topic: np.array([m["log_time"] for m in messages]) for topic, messages in topics.items()}
    latest = {topic: np.searchsorted(t, times[clock], side="right") - 1 for topic, t in times.items()}
    latest[clock] = np.arange(len(times[clock]))
    keep = np.all([k >= 0 for k in latest.values()], axis=0)
    columns = {}
    for topic, messages in topics.items():
        names = dict.fromkeys(name for message in messages for name in message)
        for name in names:
            values = np.array([m.get(name, np.nan) for m in messages])
            column = topic if name == IMAGE else f"{topic}.{name}"
            columns[column] = values[latest[topic][keep]] if len(values) else values
    return columns

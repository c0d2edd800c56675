"""MCAP files: messages of several topics, in JSON, ROS 2 (CDR) or protobuf."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from datamodules.recordings.errors import RecordingError, listing, optional
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.messages import Message, collect_topics
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.topics import Topic, read_log

DECODERS = {"mcap_ros2.decoder": "mcap-ros2-support", "mcap_protobuf.decoder": "mcap-protobuf-support"}


def read_mcap(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a file as one episode: columns ``<topic>.<field>``, such as ``/joint_states.position[elbow]``.

    Every topic also has ``<topic>.log_time`` and ``<topic>.publish_time`` in ns. Images are a topic's: ROS's ``Image``
    or ``CompressedImage``, or what else has a picture's bytes in ``data``.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    return read_mcap_files(path, [path], mapping)


def read_mcap_files(path: Path, files: list[Path], mapping: Mapping) -> list[Recorded]:
    """Read the files that one recording was split into, as one episode.

    Args:
        path: of the recording, for messages.
        files: in the order of their times.
        mapping: says which columns are wanted.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    optional("mcap", "mcap", path)
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with ExitStack() as opened:
            readers = [(file, make_reader(opened.enter_context(file.open("rb")))) for file in files]
            names = set().union(*(_topic_names(reader) for _, reader in readers))

            def read(topics: list[str], images: ImageColumn | None, most: int | None) -> dict[str, Topic]:
                messages = (m for file, reader in readers for m in _messages(file, reader, topics))
                return collect_topics(path, messages, topics, images, most)

            return read_log(path, names, mapping, read)
    except (McapError, EOFError) as error:
        raise RecordingError(f"{path}: not a readable MCAP file (truncated or of another kind): {error!r}") from None


def _messages(path: Path, reader: Any, topics: list[str]) -> Iterator[Message]:
    factories = [JsonDecoder(), *_decoder_factories()]
    for schema, channel, message in reader.iter_messages(topics=topics):
        times = {"log_time": message.log_time, "publish_time": message.publish_time}
        yield Message(channel.topic, times, partial(_decode, path, factories, schema, channel, message))


def _topic_names(reader: Any) -> set[str]:
    """Topics with messages; a recording that was cut short has no summary, so its messages are walked."""
    summary = reader.get_summary()
    if summary is not None and summary.channels:
        return {channel.topic for channel in summary.channels.values()}
    return {channel.topic for _, channel, _ in reader.iter_messages()}


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

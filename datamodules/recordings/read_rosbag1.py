"""Bags of ROS 1 (``.bag``), which hold their messages' definitions; no ROS is needed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from datamodules.recordings.errors import RecordingError, expect_magic, optional
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.messages import Message, collect_topics, decode_message
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.topics import LOG_TIME, Topic, read_log

MAGIC = b"#ROSBAG V2.0\n"
TYPE = r"[A-Za-z]\w*(?:/[A-Za-z]\w*)?"
FIELD = re.compile(rf"{TYPE}(?:\[\d*\])? +[A-Za-z]\w*", re.ASCII)
INNER = re.compile(rf"=+|MSG: {TYPE}", re.ASCII)
CONSTANT = re.compile(rf"{TYPE} +[A-Za-z]\w* *=.*", re.ASCII)
"""Lines of a definition: a field, where that of a type within it begins, and a constant, which no message carries."""


def read_rosbag1(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a bag as one episode: columns ``<topic>.<field>``, such as ``/joint_states.position[elbow]``.

    Every topic also has ``<topic>.log_time`` in ns. Bags compressed with bz2 or lz4 are read as they are.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    rosbag1 = optional("rosbags.rosbag1", "rosbags", path)
    expect_magic(path, MAGIC, "bag of ROS 1, version 2.0")
    try:
        with rosbag1.Reader(path) as bag:
            kept = [c for c in bag.connections if c.msgcount]
            decoders = {c.id: _decoder(path, c.topic, c.msgtype, c.msgdef.data) for c in kept}

            def read(topics: list[str], images: ImageColumn | None, most: int | None) -> dict[str, Topic]:
                wanted = [c for c in kept if c.topic in topics]
                messages = _messages(path, bag.messages(connections=wanted), decoders) if wanted else iter(())
                return collect_topics(path, messages, topics, images, most)

            return read_log(path, [c.topic for c in kept], mapping, read)
    except rosbag1.ReaderError as error:
        cure = "; `rosbag reindex` mends a bag that its recorder did not close" if "index" in str(error) else ""
        raise RecordingError(f"{path}: not a readable bag of ROS 1 (truncated or damaged): {error}{cure}") from None


def _messages(path: Path, rows: Iterator[tuple[Any, int, bytes]], decoders: dict[int, Callable]) -> Iterator[Message]:
    for c, time, data in rows:
        decode = partial(decode_message, path, c.topic, c.msgtype, time, decoders[c.id], data)
        yield Message(c.topic, {LOG_TIME: time}, decode)


def _decoder(path: Path, topic: str, kind: str, text: str) -> Callable[[bytes], Any]:
    """A decoder, made when the first message comes, with types of its own: two topics may define one differently."""
    types = cache(partial(_types, path, topic, kind, text))
    return lambda data: types().deserialize_ros1(data, kind)


def _types(path: Path, topic: str, kind: str, text: str) -> Any:
    typesys = optional("rosbags.typesys", "rosbags", path)
    fields = plain_definition(f"{path}: topic {topic}: the definition of {kind}", text)
    try:
        types = typesys.get_typestore(typesys.Stores.EMPTY)
        types.register(typesys.get_types_from_msg(fields, kind))
    except Exception as error:  # the parser raises what it likes on a definition that is none
        told = " ".join(str(error).split())[:200]
        raise RecordingError(f"{path}: topic {topic}: the definition of {kind} is not readable: {told}") from None
    return types


def plain_definition(where: str, text: str) -> str:
    """A message's definition without comments and constants.

    The decoder is compiled from it, so nothing but names and numbers may be in it.

    Raises:
        RecordingError: naming a line that is no part of a definition.
    """
    kept = []
    for line in text.splitlines():
        if CONSTANT.fullmatch(line.strip()):  # before comments: a constant's text may have a #
            continue
        bare = " ".join(line.split("#")[0].split())
        if bare and not (FIELD.fullmatch(bare) or INNER.fullmatch(bare)):
            raise RecordingError(f"{where}: line {line.strip()[:80]!r} is no field; expected <type> <name>")
        kept.append(bare)
    return "\n".join(kept)

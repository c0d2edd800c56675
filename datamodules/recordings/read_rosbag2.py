"""Bags of ROS 2 (rosbag2): an SQLite file, or a folder with ``metadata.yaml``; no ROS is needed."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any

from datamodules.recordings.errors import RecordingError, expect_magic, listing
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.messages import Message, collect_topics, decode_message
from datamodules.recordings.read_mcap import read_mcap_files
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.ros2_types import type_decoder
from datamodules.recordings.topics import LOG_TIME, Topic, read_log
from datamodules.safe_yaml import read_yaml

SQLITE_MAGIC = b"SQLite format 3\0"
LARGEST_MESSAGE = 2**28
"""Bytes of a text or message in the database; a larger one is refused."""


def read_rosbag2(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read a bag as one episode: columns ``<topic>.<field>``, such as ``/joint_states.position[elbow]``.

    Every topic also has ``<topic>.log_time`` in ns. A bag whose storage is MCAP is read as that format is.

    Raises:
        RecordingError: naming the file, the topic or column, what was expected and what came.
    """
    files = _files(path) if path.is_dir() else [path]
    if all(file.suffix == ".mcap" for file in files):
        return read_mcap_files(path, files, mapping)
    try:
        with ExitStack() as opened:
            bags = [(file, opened.enter_context(closing(_connect(file)))) for file in files]
            topics = [(file, bag, _topics(file, bag)) for file, bag in bags]
            names = [name for _, _, found in topics for name, _, _ in found.values()]

            def read(wanted: list[str], images: ImageColumn | None, most: int | None) -> dict[str, Topic]:
                messages = (m for file, bag, found in topics for m in _messages(file, bag, found, wanted))
                return collect_topics(path, messages, wanted, images, most)

            return read_log(path, names, mapping, read)
    except sqlite3.Error as error:
        raise RecordingError(f"{path}: not a readable rosbag2 file (truncated or damaged): {error}") from None


def _files(folder: Path) -> list[Path]:
    """The bag's files in their order, as its metadata have them."""
    about = folder / "metadata.yaml"
    if not about.is_file():
        return sorted(folder.glob("*.db3"))
    try:
        content = read_yaml(about)
    except ValueError as error:
        raise RecordingError(str(error)) from None
    info = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    names = info.get("relative_file_paths") if isinstance(info, dict) else None
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise RecordingError(f"{about}: expected relative_file_paths in rosbag2_bagfile_information, as rosbag2 writes")
    assert isinstance(info, dict)
    if info.get("compression_mode") or info.get("compression_format"):
        raise RecordingError(f"{folder}: the bag is compressed; `ros2 bag convert` makes one that is not")
    files = [folder / Path(name).name for name in names]  # old bags name the folder too; nothing outside it is read
    if absent := [file.name for file in files if not file.is_file()]:
        raise RecordingError(f"{about}: names files that are not in its folder: {listing(absent)}")
    return files


def _connect(path: Path) -> sqlite3.Connection:
    """The database, to be read only, as a file that nobody writes to."""
    expect_magic(path, SQLITE_MAGIC, "rosbag2 file (SQLite)")
    with path.open("rb") as f:
        header = f.read(100)
    if (size := path.stat().st_size) < (whole := _size_in(header)):
        raise RecordingError(f"{path}: the rosbag2 file is cut short: {size} of {whole} bytes are there; copy it again")
    rest = path.with_name(f"{path.name}-wal")
    if rest.is_file() and rest.stat().st_size:
        raise RecordingError(
            f"{path}: {rest.name} beside it holds messages that were not written into it yet: the recorder still runs "
            f'or was cut off; `sqlite3 {path.name} "pragma wal_checkpoint(truncate)"` puts them in'
        )
    bag = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_MESSAGE)
    bag.execute("PRAGMA trusted_schema = OFF")
    return bag


def _size_in(header: bytes) -> int:
    """Bytes that a database has by its first 100; 0 where they do not tell."""
    if len(header) < 100 or header[24:28] != header[92:96]:
        return 0
    page = int.from_bytes(header[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(header[28:32], "big")


def _topics(path: Path, bag: sqlite3.Connection) -> dict[int, tuple[str, str, Callable[[bytes], Any]]]:
    """Topics that have messages, by their number: name, type and decoder."""
    # A view or virtual table of that name would let the file say what is computed.
    plain = "type = 'table' AND sql LIKE 'CREATE TABLE%'"
    tables = {name for (name,) in bag.execute(f"SELECT name FROM sqlite_master WHERE {plain}")}
    if not {"topics", "messages"} <= tables:
        raise RecordingError(
            f"{path}: an SQLite file, but no rosbag2 bag: expected tables topics and messages, got "
            + listing(sorted(tables))
        )
    texts: dict[str, str] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
        texts = {str(kind): str(text) for kind, text in bag.execute(query)}
    found = {}
    query = "SELECT id, name, type, serialization_format FROM topics WHERE id IN (SELECT topic_id FROM messages)"
    for number, name, kind, encoding in bag.execute(query):
        if encoding == "cdr":
            decoder: Callable[[bytes], Any] = type_decoder(path, str(name), str(kind), texts.get(str(kind), ""))
        else:
            decoder = partial(_unknown, f"{path}: topic {name} is serialised as {encoding!r}; expected cdr")
        found[int(number)] = (str(name), str(kind), decoder)
    return found


def _unknown(told: str, data: bytes) -> Any:
    raise RecordingError(told)


def _messages(
    path: Path, bag: sqlite3.Connection, topics: dict[int, tuple[str, str, Callable]], wanted: list[str]
) -> Iterator[Message]:
    numbers = [number for number, (name, _, _) in topics.items() if name in wanted]
    marks = ",".join("?" * len(numbers))
    query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp"
    for number, time, data in bag.execute(query, numbers):
        name, kind, decoder = topics[number]
        if not isinstance(time, int) or not isinstance(data, bytes):
            raise RecordingError(f"{path}: topic {name}: a message has time {str(time)[:40]!r}, expected ns and bytes")
        yield Message(name, {LOG_TIME: time}, partial(decode_message, path, name, kind, time, decoder, data))

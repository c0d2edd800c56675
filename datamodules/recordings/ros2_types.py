"""Decoders of ROS 2 messages by type, from the definition in a bag or, in old bags, from ROS's own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from datamodules.recordings.errors import RecordingError, optional


def type_decoder(path: Path, topic: str, kind: str, text: str) -> Callable[[bytes], Any]:
    """A decoder of CDR messages, made when the first of them comes.

    Args:
        path: of the bag, for messages.
        topic: whose messages they are, for messages.
        kind: type of the messages, such as ``sensor_msgs/msg/JointState``.
        text: its definition in ROS's .msg format, with those it contains; empty if the bag has none, as bags before
            ROS 2 Iron have.
    """
    made: list[Callable[[bytes], Any]] = []

    def decode(data: bytes) -> Any:
        if not made:
            made.append(_decoder(path, topic, kind, text or _own_definition(path, topic, kind)))
        return made[0](data)

    return decode


def _decoder(path: Path, topic: str, kind: str, text: str) -> Callable[[bytes], Any]:
    module = optional("mcap_ros2.decoder", "mcap-ros2-support", path)
    from mcap.records import Schema

    schema = Schema(id=1, name=kind, encoding="ros2msg", data=text.encode())
    try:
        found = module.DecoderFactory().decoder_for("cdr", schema)
    except Exception as error:  # the parser raises what it likes on a definition that is none
        told = " ".join(str(error).split())[:200]
        raise RecordingError(f"{path}: topic {topic}: the definition of {kind} is not readable: {told}") from None
    assert found is not None  # it has one for every schema in this encoding
    return found


def _own_definition(path: Path, topic: str, kind: str) -> str:
    """ROS's own definition of a type, as of Humble, the last whose bags do not hold it.

    Raises:
        RecordingError: if ROS has no such type.
    """
    typesys = optional("rosbags.typesys", "rosbags", path)
    try:
        text, _ = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).generate_msgdef(kind, ros_version=2)
    except Exception:  # it raises KeyError or its own errors for a type that it does not have
        raise RecordingError(
            f"{path}: topic {topic} has messages of type {kind}, which the bag does not define and which is none of "
            "ROS's own; where ROS has it installed, `ros2 bag convert` makes an MCAP file with the definition"
        ) from None
    return str(text)

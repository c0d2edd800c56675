"""A map's alternatives: of several columns for one channel that which a recording has."""

from __future__ import annotations

from dataclasses import replace

from datamodules.recordings.errors import RecordingError, choices, listing
from datamodules.recordings.mapping import Channel, Mapping
from datamodules.recordings.recorded import Recorded


def chosen(mapping: Mapping, recorded: Recorded) -> Mapping:
    """The map with one column for each channel, the first of its alternatives that the recording has.

    Raises:
        RecordingError: naming the recording, the key and the columns, if it has none of several.
    """

    def pick(key: str, names: tuple[str, ...]) -> str:
        found = next((name for name in names if name in recorded.columns), None)
        if found is None and len(names) > 1:
            raise RecordingError(
                f"{recorded.source}: none of the columns {listing(names)}, which the map names at {key}; "
                + choices(names[0], recorded.columns, "columns are")
            )
        return found or names[0]

    def one(channel: Channel) -> Channel:
        if not channel.others:
            return channel
        return replace(channel, columns=(pick(channel.key, channel.columns + channel.others),), others=())

    joints = {
        name: replace(
            joint, position=one(joint.position), velocity=None if joint.velocity is None else one(joint.velocity)
        )
        for name, joint in mapping.joints.items()
    }
    time = mapping.time
    if time is not None and mapping.other_times:
        time = (pick("time.column", (time[0], *mapping.other_times)), time[1])
    actuators = {name: one(channel) for name, channel in mapping.actuators.items()}
    return replace(mapping, joints=joints, actuators=actuators, time=time, other_times=())

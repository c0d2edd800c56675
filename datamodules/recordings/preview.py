"""What was understood of a recording, as rows of a table and a few lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datamodules.recordings.convert import Imported
from datamodules.recordings.mapping import Channel, Mapping


@dataclass(frozen=True)
class Row:
    """One channel: what it is, where it comes from, and its numbers in ``unit``, over all episodes."""

    name: str
    column: str
    recorded_in: str
    unit: str
    minimum: float
    maximum: float
    rms: float


def summary(imported: Imported, mapping: Mapping) -> tuple[list[Row], list[str]]:
    """The preview: a row a channel, and lines about episodes and time."""
    return _rows(imported, mapping), _lines(imported)


def _rows(imported: Imported, mapping: Mapping) -> list[Row]:
    joints = mapping.joints.items()
    groups = []
    if mapping.joints:
        positions = [(f"{name} position", joint.position, joint.position_columns) for name, joint in joints]
        groups.append(("observations", "qpos", positions))
    if mapping.velocities:
        velocities = zip(mapping.joints, mapping.velocities, strict=True)
        groups.append(("observations", "qvel", [_named(f"{name} velocity", channel) for name, channel in velocities]))
    groups.append(("actions", "", [_named(f"{name} command", channel) for name, channel in mapping.actuators.items()]))
    rows = []
    for group, array, channels in groups:
        parts = [getattr(e, group)[array] if array else getattr(e, group) for e in imported.trajectories]
        columns = [(name, channel, " or ".join(names)) for name, channel, of in channels for names in of]
        for (name, channel, column), values in zip(columns, np.concatenate(parts).T, strict=True):
            rows.append(_row(name, channel, column, values))
    return rows


def _named(name: str, channel: Channel) -> tuple[str, Channel, tuple[tuple[str, ...], ...]]:
    return name, channel, channel.alternatives or (("constant",),)


def _row(name: str, channel: Channel, column: str, values: np.ndarray) -> Row:
    unit = channel.unit
    change = "".join(
        (
            f" x {channel.scale:g}" if channel.scale != 1 else "",
            " x -1" if channel.sign == -1 else "",
            f" {channel.offset:+g} {unit.si}".rstrip() if channel.offset and not channel.constant else "",
            " held" if channel.hold else "",
        )
    )
    values = values.astype(np.float64)
    rms = float(np.sqrt(np.mean(values**2)))
    recorded_in = ((unit.name or unit.si) + change).strip()
    return Row(name, column, recorded_in, unit.si, float(values.min()), float(values.max()), rms)


def _lines(imported: Imported) -> list[str]:
    trajectories, timing = imported.trajectories, imported.timing
    first = trajectories.episodes[0]
    lengths = [len(e) for e in trajectories]
    spread = f"{lengths[0]}" if min(lengths) == max(lengths) else f"{min(lengths)} to {max(lengths)}"
    sampling = "regular" if timing.regular else "irregular, timestamps are kept"
    lines = [
        f"episodes {len(trajectories)}, steps {trajectories.total_steps} ({spread} an episode), "
        f"duration {timing.duration:.4g} s",
        f"dt {timing.dt:.6g} s, jitter {timing.jitter:.2%}: {sampling}",
        ", ".join(_shape(name, first.observations.get(name)) for name in ("qpos", "qvel"))
        + (f", {_shape('pixels', first.observations['pixels'])}" if "pixels" in first.observations else "")
        + f", actions {first.actions.shape[1]}"
        + (" (passive: nothing is driven)" if not first.actions.shape[1] else ""),
    ]
    if first.infos:
        lines.append(f"infos kept: {', '.join(first.infos)}")
    return lines


def _shape(name: str, array: np.ndarray | None) -> str:
    """How many numbers, or pixels, a row of an observation has."""
    return f"no {name}" if array is None else f"{name} {' x '.join(map(str, array.shape[1:3]))}"

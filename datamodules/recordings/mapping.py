"""The map: a small YAML file that says which column is which joint, actuator and time (docs/guide/import.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.recordings.axes import ANGLES, Axes, has_angles, parse_axes
from datamodules.recordings.errors import RecordingError
from datamodules.recordings.map_values import (
    column_name,
    column_names,
    count_of,
    named_entries,
    number_of,
    one_of,
    part_name,
    section,
    text_of,
)
from datamodules.recordings.units import TIME, Unit, actuator_unit, position_unit, velocity_unit
from datamodules.safe_yaml import read_yaml

KEYS = (
    *("time", "dt", "joints", "actuators", "images", "infos", "episodes", "actions_at"),
    *("skip_rows", "header", "delimiter", "clock"),
)
SHORTEST_PERIOD, LONGEST_PERIOD = 1e-6, 100.0
"""Control period [s] beyond which a unit is wrong."""
SMALLEST_IMAGE, LARGEST_IMAGE = 16, 1024
"""Side of an image, pixels."""
CHANNEL_KEYS = ("column", "unit", "sign", "scale", "offset", "constant", "hold")
PARTS: dict[Callable[[str, str], Unit], tuple[int, ...]] = {
    position_unit: (4, 7), velocity_unit: (3, 6), actuator_unit: (),
}  # fmt: skip
"""A list of so many columns, with no other key, is a ball or free joint's; another list names alternatives."""


@dataclass(frozen=True)
class Channel:
    """Where one quantity comes from: value = sign * scale * unit * column + offset.

    Attributes:
        key: its place in the map, such as ``joints.hip.position``, for messages.
        columns: one column; several for a ball or free joint, in the model's order; none for a constant.
        hold: whether the last value holds in empty cells, as where it was logged at another rate than the rest.
        others: columns that are taken where a file does not have the one, the first that it has.
        unit: of the column.
        sign: 1 or -1.
        scale: further factor, for units that have no name here.
        offset: added last, in the unit of the model (rad, m, N m, ...); the value itself where it is constant.
    """

    key: str
    columns: tuple[str, ...]
    unit: Unit = field(default_factory=Unit)
    sign: int = 1
    scale: float = 1.0
    offset: float = 0.0
    others: tuple[str, ...] = ()
    hold: bool = False

    @property
    def alternatives(self) -> tuple[tuple[str, ...], ...]:
        """The columns, each with those that may stand in for it."""
        return tuple((column, *self.others) for column in self.columns)

    @property
    def constant(self) -> bool:
        """Whether no column is behind it."""
        return not self.columns

    def value(self, recorded: np.ndarray, largest: float) -> np.ndarray:
        """Numbers of a column, in the model's unit.

        Args:
            recorded: as they were recorded.
            largest: number that the file they go to can hold.

        Raises:
            RecordingError: if one is larger.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            values = self.sign * self.scale * self.unit.factor * recorded + self.offset
        if not (np.abs(values) <= largest).all():
            k = int(np.flatnonzero(~(np.abs(values) <= largest))[0])
            raise RecordingError(
                f"{self.key}: {recorded[k]:g} of column {self.columns[0]!r} becomes {values[k]:g} with its unit, scale "
                "and offset, which no file can hold: correct them, or cut the recording"
            )
        return values


@dataclass(frozen=True)
class Joint:
    """A joint's position [rad or m] and, where it was measured, velocity [rad/s or m/s].

    Attributes:
        axes: of a ball or free joint, where they are not MuJoCo's.
    """

    position: Channel
    velocity: Channel | None = None
    axes: Axes | None = None

    @property
    def position_columns(self) -> tuple[tuple[str, ...], ...]:
        """Of every number in qpos the columns that it is of, alternatives; several make one of a quaternion."""
        columns = self.position.alternatives or (("constant",),)
        if self.axes is None or not self.axes.angles:
            return columns
        return (*columns[:-ANGLES], *4 * ((", ".join(self.position.columns[-ANGLES:]),),))


@dataclass(frozen=True)
class ImageColumn:
    """Where images come from, and the side of the square that each becomes, pixels."""

    column: str
    size: int = 128


@dataclass(frozen=True)
class Mapping:
    """What a map says.

    Attributes:
        joints, actuators: by name, in the order of the map.
        time: column with the time of each row and its unit in s; None where ``dt`` is given.
        other_times: columns of that unit that are taken where a file does not have the one.
        dt: period, s, of recordings without times.
        images: those of the robot; None if they are not wanted.
        infos: name to column, kept as it is.
        episodes: column that tells episodes apart; None: one recording is one episode.
        actions_at: ``start``: a row's command is held from that row to the next; ``end``: until that row.
        skip_rows, header, delimiter: how to read CSV.
        clock: topic whose messages are the rows; None: that of the first mapped position.
        source: the map's file, for messages.
    """

    joints: dict[str, Joint]
    actuators: dict[str, Channel]
    time: tuple[str, float] | None = None
    dt: float | None = None
    images: ImageColumn | None = None
    infos: dict[str, str] = field(default_factory=dict)
    episodes: str | None = None
    actions_at: str = "start"
    skip_rows: int = 0
    header: bool = True
    delimiter: str | None = None
    clock: str | None = None
    source: str = "map"
    other_times: tuple[str, ...] = ()

    @property
    def survey(self) -> bool:
        """Whether it names no columns, because all of them are wanted."""
        return not self.joints and self.images is None

    @property
    def row_column(self) -> tuple[str, str]:
        """The column whose rows are the recording's, one of :meth:`alternatives`' first, and its key in the map."""
        for joint in self.joints.values():
            if not joint.position.constant:
                return joint.position.columns[0], joint.position.key
        assert self.images is not None  # a map has one or the other
        return self.images.column, "images.column"

    @property
    def velocities(self) -> list[Channel]:
        """The joints' velocities, in the order of the map; empty unless all were measured."""
        measured = [joint.velocity for joint in self.joints.values() if joint.velocity is not None]
        return measured if len(measured) == len(self.joints) else []

    @property
    def channels(self) -> list[Channel]:
        """Positions and velocities of the joints, then commands."""
        measured = [c for joint in self.joints.values() for c in (joint.position, joint.velocity) if c is not None]
        return [*measured, *self.actuators.values()]

    def wanted(self) -> Iterator[tuple[str, ...]]:
        """Every column that the map names, with its alternatives; the first is the first joint's position."""
        for joint in self.joints.values():
            yield from joint.position.alternatives
        for joint in self.joints.values():
            yield from joint.velocity.alternatives if joint.velocity else ()
        for channel in self.actuators.values():
            yield from channel.alternatives
        yield from ((column,) for column in self.infos.values())
        if self.time:
            yield (self.time[0], *self.other_times)
        if self.episodes:
            yield (self.episodes,)

    def columns(self) -> Iterator[str]:
        """Every column that the map names, all alternatives too."""
        for columns in self.wanted():
            yield from columns


def read_mapping(path: Path | str) -> Mapping:
    """Read and check a map.

    Raises:
        RecordingError: naming the file, the key, what was expected and what came.
    """
    path = Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; expected the map, see docs/guide/import.md")
    try:
        content = read_yaml(path)
    except ValueError as error:
        raise RecordingError(f"{error}; see docs/guide/import.md") from None
    return parse_mapping(content, str(path))


def parse_mapping(content: Any, source: str = "map") -> Mapping:
    """Check a map that was read from YAML.

    Args:
        content: of the YAML file.
        source: its name, for messages.

    Raises:
        RecordingError: naming the source, the key, what was expected and what came.
    """
    try:
        return _mapping(content, source)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}") from None


def _mapping(content: Any, source: str) -> Mapping:
    top = section("the map", content, KEYS)
    time, other_times, dt = _clock(top)
    joints = {name: _joint(f"joints.{name}", value) for name, value in named_entries("joints", top.get("joints"))}
    if "images" not in top and all(joint.position.constant for joint in joints.values()):
        raise RecordingError(
            "joints: expected at least one joint with a position column, or images; see docs/guide/import.md"
        )
    actuators = {
        name: _channel(f"actuators.{name}", value, actuator_unit)
        for name, value in named_entries("actuators", top.get("actuators"))
    }
    infos = {
        part_name(name): column_name(f"infos.{name}", value) for name, value in named_entries("infos", top.get("infos"))
    }
    episodes = section("episodes", top["episodes"], ("column",)) if "episodes" in top else {}
    delimiter, clock = (None if top.get(k) is None else text_of(k, top[k]) for k in ("delimiter", "clock"))
    if delimiter is not None and len(delimiter) != 1:
        raise RecordingError(f"delimiter: expected one character, got {delimiter!r}")
    return Mapping(
        joints=joints,
        actuators=actuators,
        time=time,
        dt=dt,
        images=_images(top["images"]) if "images" in top else None,
        infos=infos,
        episodes=column_name("episodes.column", episodes.get("column")) if "episodes" in top else None,
        actions_at=one_of("actions_at", top.get("actions_at", "start"), ("start", "end")),
        skip_rows=count_of("skip_rows", top.get("skip_rows", 0)),
        header=one_of("header", top.get("header", True), (True, False)),
        delimiter=delimiter,
        clock=clock,
        source=source,
        other_times=other_times,
    )


def _clock(top: dict) -> tuple[tuple[str, float] | None, tuple[str, ...], float | None]:
    """The time column with its unit [s] and its alternatives, or the period [s]."""
    if ("time" in top) == ("dt" in top):
        came = "both" if "time" in top else "neither"
        raise RecordingError(
            f"expected either time, such as time: {{column: t, unit: s}}, or dt: <seconds>; it has {came}"
        )
    if "dt" in top:
        dt = number_of("dt", top["dt"])
        if not SHORTEST_PERIOD <= dt <= LONGEST_PERIOD:
            allowed = f"{SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} seconds"
            raise RecordingError(f"dt: expected a period of {allowed}, got {dt:g}")
        return None, (), dt
    value = top["time"] if isinstance(top["time"], dict) else {"column": top["time"]}
    entry = section("time", value, ("column", "unit"))
    unit = text_of("time.unit", entry.get("unit", "s"))
    column, *others = column_names("time.column", entry.get("column"))
    return (column, TIME[one_of("time.unit", unit, tuple(TIME))]), tuple(others), None


def _images(value: Any) -> ImageColumn:
    entry = section("images", value if isinstance(value, dict) else {"column": value}, ("column", "size"))
    size = count_of("images.size", entry.get("size", ImageColumn.size))
    if not SMALLEST_IMAGE <= size <= LARGEST_IMAGE:
        raise RecordingError(f"images.size: expected {SMALLEST_IMAGE} to {LARGEST_IMAGE} pixels, got {size}")
    return ImageColumn(column_name("images.column", entry.get("column")), size)


def _joint(key: str, value: Any) -> Joint:
    entry = section(key, value, ("position", "velocity", "axes"))
    if "position" not in entry:
        raise RecordingError(f"{key}: position is missing; expected position: {{column: ..., unit: rad}}")
    turned = PARTS[velocity_unit] if has_angles(entry.get("axes")) else None
    position = _channel(f"{key}.position", entry["position"], position_unit, turned)
    velocity = _channel(f"{key}.velocity", entry["velocity"], velocity_unit) if "velocity" in entry else None
    if velocity and velocity.unit.si and position.unit.si and velocity.unit.si != f"{position.unit.si}/s":
        raise RecordingError(
            f"{key}: the position is in {position.unit.name} and the velocity in {velocity.unit.name}; "
            "expected both to be of a hinge (angles) or of a slide (lengths)"
        )
    widths = len(position.columns), None if velocity is None else len(velocity.columns)
    axes = parse_axes(f"{key}.axes", entry["axes"], *widths) if "axes" in entry else None
    return Joint(position, velocity, axes)


def _channel(
    key: str, value: Any, unit_of: Callable[[str, str], Unit], parts: tuple[int, ...] | None = None
) -> Channel:
    entry = section(key, value if isinstance(value, dict) else {"column": value}, CHANNEL_KEYS)
    if "constant" in entry:
        if len(entry) > 1:
            raise RecordingError(f"{key}: constant stands alone, in the model's unit; drop the other keys")
        return Channel(key, (), offset=number_of(f"{key}.constant", entry["constant"]))
    columns = column_names(f"{key}.column", entry.get("column"))
    if len(entry) == 1 and len(columns) in (parts or PARTS[unit_of]):
        return Channel(key, columns)
    unit = Unit() if entry.get("unit") is None else unit_of(text_of(f"{key}.unit", entry["unit"]), f"{key}.unit")
    return Channel(
        key,
        columns[:1],
        unit,
        one_of(f"{key}.sign", entry.get("sign", 1), (1, -1)),
        number_of(f"{key}.scale", entry.get("scale", 1.0)),
        number_of(f"{key}.offset", entry.get("offset", 0.0)),
        columns[1:],
        one_of(f"{key}.hold", entry.get("hold", False), (True, False)),
    )

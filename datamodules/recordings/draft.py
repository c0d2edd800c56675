"""A draft of a map: what a recording's columns are, guessed from their names and numbers and a model."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from datamodules.recordings.check import SI, ActuatorLayout, JointLayout, ModelLayout
from datamodules.recordings.draft_floating import FloatingColumns, floating_columns, with_unit_of_angles
from datamodules.recordings.draft_match import Match, is_finite, match, single_names, usable_columns
from datamodules.recordings.draft_names import (
    COMMAND,
    POSITION,
    TIME_WORDS,
    VELOCITY,
    agreement,
    kind_of,
    named_unit,
    telling_words,
    wants_motion,
    words_of,
)
from datamodules.recordings.draft_units import position_measure, slope_of, time_unit, velocity_measure
from datamodules.recordings.errors import RecordingError
from datamodules.recordings.formats import find, guess, read_recording
from datamodules.recordings.hold import empty_cells, with_held_columns
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded, is_number
from datamodules.recordings.topics import LOG_TIME, topic_of, topics_in
from datamodules.recordings.units import TIME, position_unit, velocity_unit

MOST_SKIPPED = 20
"""Lines before a table's header that a draft finds by itself."""
CUT_AT_COMMAS = re.compile(r"\d+[;\t] *[-+]?\d+")
"""What stands between the commas of ``0,00;1,5``, whose columns have another separator."""
EPISODE_WORDS = {"episode", "episodes", "run", "trial", "rollout", "trajectory"}


@dataclass(frozen=True)
class Line:
    """A line of a draft: what stands in the map, None if it could not be guessed, and why."""

    entry: Any
    why: str


@dataclass
class Draft:
    """A map as far as it was guessed.

    Attributes:
        recording, model: the files, and how many rows were looked at.
        settings: ``skip_rows`` and ``header``, where they are not the usual.
        time: column and unit.
        positions, velocities: by joint.
        axes: of a floating body, by joint, where they are not MuJoCo's.
        actuators: by name.
        episodes: the column that tells them apart, None if there is none.
        left: columns that are in none of these.
    """

    recording: str
    model: str
    rows: int
    settings: dict[str, Any] = field(default_factory=dict)
    time: Line = field(default_factory=lambda: Line(None, ""))
    positions: dict[str, Line] = field(default_factory=dict)
    velocities: dict[str, Line] = field(default_factory=dict)
    axes: dict[str, Line] = field(default_factory=dict)
    actuators: dict[str, Line] = field(default_factory=dict)
    episodes: Line | None = None
    left: list[str] = field(default_factory=list)

    def used(self) -> set[str]:
        """Columns that are in the map."""
        lines = [self.time, *self.positions.values(), *self.velocities.values(), *self.actuators.values()]
        return {name for line in lines for name in columns_of(line)} | (
            {self.episodes.entry} if self.episodes else set()
        )

    def missing(self) -> list[str]:
        """Keys of the map that could not be guessed and that a map must have."""
        return [
            *(["time"] if self.time.entry is None else []),
            *(f"joints.{name}.position" for name, line in self.positions.items() if line.entry is None),
            *(f"actuators.{name}" for name, line in self.actuators.items() if line.entry is None),
        ]


def columns_of(line: Line) -> list[str]:
    """Those that a line names."""
    column = line.entry["column"] if line.entry else []
    return column if isinstance(column, list) else [column]


def draft_map(path: Path | str, model: ModelLayout, format: str | None = None) -> Draft:
    """Guess the map of a recording.

    Args:
        path: a file, a dataset's folder, or the id of a local Minari dataset; of several episodes the
            first is looked at.
        model: whose joints and actuators are wanted.
        format: one of ``FORMATS``; None: told by the name.

    Raises:
        RecordingError: if the recording cannot be read.
    """
    recorded, settings = _survey(path, format)
    free = usable_columns(recorded)
    if not free:
        raise RecordingError(f"{path}: no column holds numbers; there is nothing to guess a map from")
    if settings.get("header", True) and _is_numbered(recorded):
        settings["header"] = False
    floating = floating_columns(free) if [j.type for j in model.joints].count("free") == 1 else None
    free = [name for name in free if floating is None or name not in (*floating.position, *floating.velocity)]
    joints = {joint.name: joint for joint in model.joints if joint.type in SI}
    words = {name: telling_words(name) for name in joints}
    positions = match(words, POSITION, recorded, free)
    free = _without(free, positions)
    beside = {name: found.column for name, found in positions.items()}
    placed = [*(floating.position[:1] if floating else ()), *beside.values()]
    recorded, empty = _on_rows_of(recorded, placed, free)
    velocities = match(words, VELOCITY, recorded, free, beside)
    free = _without(free, velocities)
    driving = [c for c in free if not wants_motion(c)] if all(a.force for a in model.actuators) else free
    commands = match({a.name: _actuator_words(a, driving) for a in model.actuators}, COMMAND, recorded, driving)
    free = _without(free, commands)
    rows = max(len(recorded.columns[c]) for c in placed or free[:1])
    draft = Draft(str(path), model.name, rows, settings)
    draft.time = _time(recorded, next(iter(placed), None))
    times = _seconds(recorded, draft.time)
    for joint in model.joints:
        if joint.type == "free" and floating:
            _add_floating(draft, joint.name, floating, recorded)
            continue
        if joint.type not in SI:
            draft.positions[joint.name] = Line(None, f"a {joint.type} joint takes a list of columns, see the guide")
            continue
        _add_joint(draft, recorded, joint, positions.get(joint.name), velocities.get(joint.name), times, free)
    if floating and len(floating.motors) == len(model.actuators):
        draft.actuators = {a.name: _motor(a, c) for a, c in zip(model.actuators, floating.motors, strict=True)}
    else:
        draft.actuators = {a.name: _command(recorded, a, commands.get(a.name)) for a in model.actuators}
    for lines in (draft.positions, draft.velocities, draft.actuators):
        lines |= {name: _held(line, empty) for name, line in lines.items()}
    draft.episodes = _episodes(recorded, rows)
    draft.left = [name for name in single_names(recorded) if name not in draft.used()]
    return draft


def _survey(path: Path | str, format: str | None) -> tuple[Recorded, dict[str, Any]]:
    """All columns of the first episode, and how a table is to be read."""
    first: RecordingError | None = None
    table = (format or guess(find(path, format))) == "csv"
    for skipped in range(MOST_SKIPPED if table else 1):
        try:
            recorded = read_recording(path, Mapping({}, {}, dt=1.0, skip_rows=skipped), format)[0]
        except RecordingError as error:
            first = first or error
            continue
        if table:
            _refuse_decimal_commas(recorded)
        if table and not any(is_finite(values) for values in recorded.columns.values()):
            first = first or RecordingError(f"{path}: no column holds numbers; there is nothing to guess a map from")
            continue
        return recorded, {"skip_rows": skipped} if skipped else {}
    assert first is not None  # every attempt failed
    raise first


def _refuse_decimal_commas(recorded: Recorded) -> None:
    """Say where decimals are written with a comma; a draft would skip lines until commas separate columns.

    Raises:
        RecordingError: if a column is text only for its commas, or for what two of them have cut out of a line.
    """
    for name, cells in recorded.columns.items():
        commas = [k for k, cell in enumerate(cells) if cells.dtype.kind == "O" and "," in cell]
        if commas and all(is_number(cell.replace(",", ".") or 0) for cell in cells):
            recorded.numbers(name, name, slice(commas[0], commas[0] + 1))
        if cells.dtype.kind == "O" and all(map(CUT_AT_COMMAS.fullmatch, cells)):
            where = f"{recorded.source}: {recorded.row(0)}"
            raise RecordingError(f"{where}: {cells[0]!r} stands between two commas; write decimals with a point")


def _is_numbered(recorded: Recorded) -> bool:
    """Whether a table came without a header, so that its columns are called 0, 1, ..."""
    return list(recorded.columns) == [str(i) for i in range(len(recorded.columns))]


def _on_rows_of(recorded: Recorded, positions: list[str], others: list[str]) -> tuple[Recorded, dict[str, int]]:
    """The rows of the position that has most, and how many cells are empty there of columns whose last value holds.

    So a table is read whose topics were joined, each with rows of its own. A column that is filled in half of the rows
    and more is of the position's own topic, and lacks some numbers.
    """
    cells = {name: empty_cells(recorded.columns[name]) for name in (*positions, *others)}
    if not positions or topics_in(recorded.columns) or len({len(a) for a in cells.values()}) > 1:  # no table
        return recorded, {}
    clock = min(positions, key=lambda name: cells[name].sum())
    rows = ~cells[clock]
    held = {name: int(n) for name, a in cells.items() if (n := a[rows].sum()) > rows.sum() / 2}
    joined = with_held_columns(recorded, list(held), [clock]) if held else recorded
    return (joined, held) if len(joined.columns[clock]) > 1 else (recorded, {})


def _held(line: Line, empty: dict[str, int]) -> Line:
    """A channel's line; where its column has empty cells the last value holds."""
    n = empty.get(line.entry["column"], 0) if len(columns_of(line)) == 1 else 0
    return Line(line.entry | {"hold": True}, f"{line.why}; {n} empty cells, so the last value holds") if n else line


def _without(free: list[str], taken: dict[str, Match]) -> list[str]:
    columns = {found.column for found in taken.values()}
    return [name for name in free if name not in columns]


def _actuator_words(actuator: ActuatorLayout, free: list[str]) -> set[str]:
    """The words of its name or, where no command has one of them, of its joint's."""
    words = telling_words(actuator.name)
    if not actuator.joint or any(kind_of(c) == COMMAND and agreement(words, c) for c in free):
        return words
    return telling_words(actuator.joint)


# --- joints and actuators -------------------------------------------------------------------------------


def _add_joint(
    draft: Draft, recorded: Recorded, joint: JointLayout, position: Match | None, velocity: Match | None,
    times: np.ndarray, free: list[str],
) -> None:  # fmt: skip
    """Add a joint's lines; a free column that follows the position's slope is its velocity, whatever its name."""
    if position is None:
        draft.positions[joint.name] = Line(None, "no column has its name")
        if velocity is not None:
            draft.velocities[joint.name] = Line(None, f"perhaps {velocity.column}")
        return
    values = recorded.columns[position.column]
    slope = (0.0, 0.0)
    if velocity is not None:
        unit, _ = named_unit(velocity.column, VELOCITY)
        factor = velocity_unit(unit, "").factor if unit not in ("", "counts") else 0.0
        slope = slope_of(times, values, recorded.columns[velocity.column] * factor)
    measured = position_measure(position.column, values, joint, slope)
    entry = {"column": position.column} | ({"unit": measured.unit} if measured.unit else {})
    goes = f"goes from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
    draft.positions[joint.name] = Line(entry, f"{position.why}; {measured.why}; {goes}")
    scaled = values * (position_unit(measured.unit, "").factor if measured.unit else 1.0)
    if velocity is None:
        velocity = _follower(recorded, times, scaled, free)
        if velocity is None:
            return
        free.remove(velocity.column)
    correlation, ratio = slope_of(times, scaled, recorded.columns[velocity.column])
    speed = velocity_measure(velocity.column, joint, (correlation, 1 / ratio if ratio else 0.0))
    turned = {"sign": -1} if speed.sign == -1 else {}
    draft.velocities[joint.name] = Line(
        {"column": velocity.column, "unit": speed.unit} | turned, f"{velocity.why}; {speed.why}"
    )


def _add_floating(draft: Draft, name: str, found: FloatingColumns, recorded: Recorded) -> None:
    """Add a free joint's lines."""
    draft.positions[name] = Line({"column": list(found.position)}, found.why)
    if found.velocity:
        draft.velocities[name] = Line({"column": list(found.velocity)}, found.why)
    axes, why = with_unit_of_angles(found, recorded.columns)
    if axes:
        draft.axes[name] = Line(axes, why)


def _follower(recorded: Recorded, times: np.ndarray, positions: np.ndarray, free: list[str]) -> Match | None:
    """A column that has the course of the position's slope."""
    best = (0.95, "")
    for name in free:
        if kind_of(name) in ("", VELOCITY) and not set(words_of(name)) & TIME_WORDS:
            best = max(best, (abs(slope_of(times, positions, recorded.columns[name])[0]), name))
    return Match(best[1], "it follows the position's slope") if best[1] else None


def _motor(actuator: ActuatorLayout, column: str) -> Line:
    """The line of a motor that was commanded from 0 to 1."""
    why = "BY ITS PLACE ONLY, if the order is the model's; from 0 to 1"
    if actuator.range is None:
        return Line({"column": column}, f"{why}, add scale: what the model's motor gives at 1")
    return Line({"column": column, "scale": actuator.range[1]}, f"{why}, scaled to the model's range")


def _command(recorded: Recorded, actuator: ActuatorLayout, found: Match | None) -> Line:
    if found is None:
        return Line(None, "no command has its name")
    values = recorded.columns[found.column]
    unit, word = named_unit(found.column, COMMAND)
    told = f"{word} in its name" if unit else "no unit in its name"
    goes = f"goes from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
    if actuator.range is not None:
        goes += f", the model's range is {actuator.range[0]:.4g} to {actuator.range[1]:.4g}"
    return Line({"column": found.column} | ({"unit": unit} if unit else {}), f"{found.why}; {told}; {goes}")


# --- time and episodes ----------------------------------------------------------------------------------


def _time(recorded: Recorded, position: str | None) -> Line:
    """The column that increases and is called a time, beside the first joint's position."""
    topics = topics_in(recorded.columns)
    if topics and position is None:
        return Line(None, f"a time of the positions' topic, such as its {LOG_TIME} in ns")
    topic = topic_of(position or "", topics) or ""
    rows = len(recorded.columns[position]) if position else 0
    found = []
    for order, (name, values) in enumerate(recorded.columns.items()):
        if not is_finite(values) or (rows and len(values) != rows) or not name.startswith(f"{topic}." if topic else ""):
            continue
        words = set(words_of(name.removeprefix(topic)))
        steps = np.diff(values.astype(float))
        if not words & TIME_WORDS or np.mean(steps > 0) < 0.9:
            continue
        rank = 0 if "header" in words else 2 if "log" in words else 3 if "publish" in words else 1
        found.append((rank, order, name, int(np.sum(steps <= 0))))
    if not found:
        return Line(None, "no column that increases is called a time")
    _, _, name, back = min(found)
    measured = time_unit(name, recorded.columns[name], recorded.columns.get(f"{topic}.{LOG_TIME}"))
    why = f"increases; {measured.why}"
    if back:
        why = f"increases but for {back} rows, for which there is --repair; {measured.why}"
    return Line({"column": name, "unit": measured.unit}, why)


def _seconds(recorded: Recorded, time: Line) -> np.ndarray:
    """Times of the rows, s, from 0 on; empty where none were found."""
    if time.entry is None:
        return np.zeros(0)
    values = recorded.columns[time.entry["column"]]
    return (values - values[0]).astype(float) * TIME[time.entry["unit"]]


def _episodes(recorded: Recorded, rows: int) -> Line | None:
    """A column whose name says that it numbers episodes, and that has several values, one after another."""
    for name, values in recorded.columns.items():
        if len(values) != rows or not set(words_of(name)) & EPISODE_WORDS:
            continue
        changes = int(np.sum(values[1:] != values[:-1]))
        if 0 < changes < rows / 4:
            return Line(name, f"it changes {changes} times")
    return None

"""Recorded columns and a map make trajectories in the model's units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datamodules.recordings.alternatives import chosen
from datamodules.recordings.axes import no_rotation
from datamodules.recordings.errors import RecordingError, listing
from datamodules.recordings.hold import with_held_channels
from datamodules.recordings.mapping import LONGEST_PERIOD, SHORTEST_PERIOD, Channel, Mapping
from datamodules.recordings.recorded import Recorded
from datamodules.recordings.repair import between_empty, empty_rows, rows_to_drop
from datamodules.trajectories import Episode, Trajectories

PAUSE, PAUSE_PERIODS = 1.0, 10
"""A pause is long, and ends an episode, if it lasts longer than so many seconds and so many periods."""
IRREGULAR = 0.01
"""Periods that differ by more than this share of the median make sampling irregular: times are kept."""
MOST_DRIFT = 0.5
"""So do rows that are further than so many periods from k dt."""


@dataclass(frozen=True)
class Timing:
    """When rows were taken.

    Attributes:
        dt: period over all episodes, s; the median one where sampling is irregular.
        jitter: largest deviation of a period from ``dt``, as a share of it.
        regular: whether t_k = k ``dt`` says it all.
        duration: of all episodes together, s.
        longest: the longest period, s, and where it is.
    """

    dt: float
    jitter: float
    regular: bool
    duration: float
    longest: tuple[float, str]


@dataclass(frozen=True)
class Imported:
    """Trajectories, with what the preview tells beside them."""

    trajectories: Trajectories
    timing: Timing
    notes: tuple[str, ...] = ()


def convert(recordings: list[Recorded], mapping: Mapping, source: str = "", repair: bool = False) -> Imported:
    """Turn recorded episodes into trajectories, joints and actuators in the map's order.

    Args:
        recordings: as the readers return them.
        mapping: which column is what.
        source: what the trajectory file says of where the data come from.
        repair: leave out rows that lack a number, and single rows whose time repeats or goes back; say how many.

    Raises:
        RecordingError: naming the file, column and row, what was expected and what came.
    """
    told = tuple(note for r in recordings for note in r.notes)
    episodes = [part for r in recordings for part in (r.split(mapping.episodes) if mapping.episodes else [r])]
    episodes, held = with_held_channels(episodes, mapping)
    repaired: tuple[str, ...] = ()
    if repair:
        episodes, repaired = _repaired(episodes, mapping)
    times = [_times(episode, chosen(mapping, episode)) for episode in episodes]
    episodes, times, cut = _cut_at_pauses(episodes, times)
    timing = _timing(times, episodes)
    made = tuple(_episode(e, chosen(mapping, e), t, timing) for e, t in zip(episodes, times, strict=True))
    return Imported(
        Trajectories(made, timing.dt, source), timing, told + held + repaired + cut + _notes(mapping, timing)
    )


def _episode(recorded: Recorded, mapping: Mapping, times: np.ndarray, timing: Timing) -> Episode:
    """One episode of T+1 = len(times) rows."""
    rows = len(times)
    observations = _motion(recorded, mapping, rows) if mapping.joints else {}
    if mapping.images is not None:
        observations["pixels"] = recorded.column(mapping.images.column, "images.column")
        _check_length(recorded, mapping.images.column, len(observations["pixels"]), rows)
    commands = [_command(channel, recorded, rows, mapping.actions_at) for channel in mapping.actuators.values()]
    return Episode(
        actions=np.column_stack([np.empty((rows - 1, 0)), *commands]).astype(np.float32),
        observations=observations,
        timestamps=None if timing.regular else times,
        infos={name: _info(recorded, name, column) for name, column in mapping.infos.items()},
    )


def _motion(recorded: Recorded, mapping: Mapping, rows: int) -> dict[str, np.ndarray]:
    """Qpos and, if all were measured, qvel, in the model's units and axes."""
    joints = list(mapping.joints.values())
    positions = [_rows(joint.position, recorded, rows) for joint in joints]
    positions = [j.axes.with_quaternions(p) if j.axes else p for j, p in zip(joints, positions, strict=True)]
    for joint, of_joint in zip(joints, positions, strict=True):
        _check_rotations(recorded, joint.position, of_joint)
    turned = [j.axes.position(p) if j.axes else p for j, p in zip(joints, positions, strict=True)]
    if not mapping.velocities:
        return {"qpos": np.hstack(turned)}
    velocities = [_rows(channel, recorded, rows) for channel in mapping.velocities]
    triples = zip(joints, velocities, positions, strict=True)
    return {
        "qpos": np.hstack(turned),
        "qvel": np.hstack([j.axes.velocity(v, p) if j.axes else v for j, v, p in triples]),
    }


def _rows(channel: Channel, recorded: Recorded, rows: int) -> np.ndarray:
    """A channel's columns, (T+1, n), in the model's units."""
    if channel.constant:
        return np.full((rows, 1), channel.offset)
    blocks = []
    for column in channel.columns:
        values = recorded.numbers(column, channel.key)
        _check_length(recorded, column, len(values), rows)
        blocks.append(_converted(recorded, channel, values, np.finfo(np.float64).max))
    return np.column_stack(blocks)


def _check_rotations(recorded: Recorded, channel: Channel, positions: np.ndarray) -> None:
    """Refuse rows (n, 4 or 7) of a ball or free joint whose quaternion is none."""
    if len(channel.columns) in (4, 7) and (k := no_rotation(positions[:, -4:])) is not None:
        raise RecordingError(
            f"{recorded.source}: {channel.key}: columns {listing(channel.columns[-4:])} have length "
            f"{np.linalg.norm(positions[k, -4:]):.3g} at {recorded.row(k)}, expected 1 of a quaternion (w, x, y, z)"
        )


def _command(channel: Channel, recorded: Recorded, rows: int, at: str) -> np.ndarray:
    """Commands (T,), row k held from t_k to t_{k+1}; the row too many is dropped, and may be empty."""
    if channel.constant:
        return np.full(rows - 1, channel.offset)
    (column,) = channel.columns
    length = len(recorded.column(column, channel.key))
    _check_length(recorded, column, length, rows, rows - 1)
    keep = slice(None) if length == rows - 1 else slice(None, -1) if at == "start" else slice(1, None)
    values = recorded.numbers(column, channel.key, keep)
    return _converted(recorded, channel, values, float(np.finfo(np.float32).max))


def _converted(recorded: Recorded, channel: Channel, values: np.ndarray, largest: float) -> np.ndarray:
    try:
        return channel.value(values, float(largest))
    except RecordingError as error:
        raise RecordingError(f"{recorded.source}: {error}") from None


def _info(recorded: Recorded, name: str, column: str) -> np.ndarray:
    values = recorded.column(column, f"infos.{name}")
    return values if values.dtype.kind in "fiub" else np.array([str(v).encode() for v in values])


def _check_length(recorded: Recorded, column: str, length: int, *expected: int) -> None:
    if length not in expected:
        raise RecordingError(
            f"{recorded.source}: column {column!r} has {length} rows, expected {' or '.join(map(str, expected))} "
            "as the first joint's position has, or the images where the map has no joints"
        )


# --- time -----------------------------------------------------------------------------------------------


def _times(recorded: Recorded, mapping: Mapping) -> np.ndarray:
    """Seconds since the episode's first row, (T+1,), increasing."""
    rows = len(recorded.column(*mapping.row_column))
    if rows < 2:
        raise RecordingError(f"{recorded.source}: has {rows} rows, expected at least 2 to make one step")
    if mapping.time is None:
        assert mapping.dt is not None  # a map has one or the other
        return mapping.dt * np.arange(rows)
    column, unit = mapping.time
    raw = recorded.numbers(column, "time.column")
    _check_length(recorded, column, len(raw), rows)
    times = (raw - raw[0]) * unit
    if len(back := np.flatnonzero(np.diff(times) <= 0)):
        k = back[0] + 1
        how = "stands still at" if raw[k] == raw[k - 1] else f"goes back from {raw[k - 1]:.12g} to"
        raise RecordingError(
            f"{recorded.source}: time column {column!r}, {recorded.row(k)}: time {how} {raw[k]:.12g}, expected it to "
            f"increase ({len(back)} such rows); where episodes follow one another, name their column "
            "(episodes: {column: ...}) or cut the file; --repair drops single such rows"
        )
    return times


def _repaired(episodes: list[Recorded], mapping: Mapping) -> tuple[list[Recorded], tuple[str, ...]]:
    """Episodes without rows that lack a number, and what to tell of it; then without single slips of the clock."""
    parts, lacking = [], []
    for episode in episodes:
        empty = empty_rows(episode, chosen(mapping, episode))
        lacking += [f"{episode.source}, {episode.row(int(k))}" for k in np.flatnonzero(empty)]
        parts += between_empty(episode, empty) if empty.any() else [episode]
    if not parts:
        raise RecordingError(
            f"{episodes[0].source}: --repair: no two rows in a row have all numbers of the map; where a channel was "
            "logged at another rate than the rest, let the last value hold (hold: true of the channel)"
        )
    notes: list[str] = []
    if lacking:
        cut = f", and {len(parts)} episodes are left of {len(episodes)}" if len(parts) != len(episodes) else ""
        notes.append(f"{len(lacking)} rows without numbers are left out, the first {lacking[0]}{cut}")
    if mapping.time is not None:
        parts, slips = _without_slips(parts, mapping)
        if slips:
            notes.append(f"{len(slips)} rows whose time repeats or goes back are left out, the first {slips[0]}")
    return parts, tuple(notes) or ("--repair found no row without numbers and no time that repeats or goes back",)


def _without_slips(episodes: list[Recorded], mapping: Mapping) -> tuple[list[Recorded], list[str]]:
    """Episodes without single rows whose time repeats or goes back, and where these were."""
    kept, dropped = [], []
    for episode in episodes:
        time = chosen(mapping, episode).time
        assert time is not None  # a map without one has no slips
        times = episode.numbers(time[0], "time.column")
        drop = rows_to_drop(times)
        dropped += [f"{episode.source}, {episode.row(k)}" for k in drop]
        kept.append(episode.without(drop, len(times)) if drop else episode)
    return kept, dropped


def _cut_at_pauses(
    episodes: list[Recorded], times: list[np.ndarray]
) -> tuple[list[Recorded], list[np.ndarray], tuple[str, ...]]:
    """Episodes without long pauses, in which nobody knows what was commanded; and what to tell of it."""
    period = float(np.median(np.concatenate([np.diff(t) for t in times])))
    long = max(PAUSE, PAUSE_PERIODS * period)
    parts, lost, pauses = [], 0, []
    for episode, t in zip(episodes, times, strict=True):
        ends = [*np.flatnonzero(np.diff(t) > long) + 1, len(t)]
        pauses += [(t[k] - t[k - 1], f"{episode.source}, {episode.row(k - 1)}") for k in ends[:-1]]
        for a, b in zip([0, *ends[:-1]], ends, strict=True):
            lost += b - a < 2
            if b - a > 1:
                parts.append((episode if len(ends) == 1 else episode.rows(a, b, len(t)), t[a:b] - t[a]))
    if not pauses:
        return episodes, times, ()
    if not parts:
        raise RecordingError(f"{episodes[0].source}: every row is followed by a pause; is the unit of time right?")
    longest, where = max(pauses)
    note = (
        f"{len(pauses)} pauses of more than {long:.3g} s, the longest {longest:.3g} s after {where}: the recording is "
        f"cut there, into {len(parts)} episodes" + (f" ({lost} single rows are left out)" if lost else "")
    )
    return [p for p, _ in parts], [t for _, t in parts], (note,)


def _timing(times: list[np.ndarray], episodes: list[Recorded]) -> Timing:
    periods = np.concatenate([np.diff(t) for t in times])
    dt = _period(times, periods)
    jitter = float(np.abs(periods - dt).max() / dt)
    if not SHORTEST_PERIOD <= dt <= LONGEST_PERIOD:
        raise RecordingError(f"{episodes[0].source}: rows are {dt:.3g} s apart; is the unit of time right (time.unit)?")
    drift = max(np.abs(t - dt * np.arange(len(t))).max() for t in times) / dt
    longest = max(range(len(times)), key=lambda i: np.diff(times[i]).max())
    gaps = np.diff(times[longest])
    where = f"{episodes[longest].source}, {episodes[longest].row(int(gaps.argmax()))}"
    return Timing(
        dt,
        jitter,
        bool(jitter <= IRREGULAR and drift <= MOST_DRIFT),
        float(sum(t[-1] for t in times)),
        (float(gaps.max()), where),
    )


def _period(times: list[np.ndarray], periods: np.ndarray) -> float:
    """Seconds between rows: from an episode's first to its last where they are even, else the median.

    Every single period, and so their median, is off by what a clock cannot tell apart (2.4e-7 s in float64 seconds
    since 1970); from the first row to the last that counts once. The shortest number that agrees so well is taken.
    """
    median = float(np.median(periods))
    if not np.abs(periods - median).max() <= IRREGULAR * median:
        return float(f"{median:.12g}")  # without the last digits' rounding
    mean = float(sum(t[-1] for t in times)) / len(periods)
    grid = 2 * float(np.abs(periods - mean).max())  # between two marks of a grid, one is half a step away or more
    close = max(grid * len(times) / len(periods), 1e-12 * mean)
    return next(p for digits in range(1, 18) if abs((p := float(f"{mean:.{digits}g}")) - mean) <= close)


def _notes(mapping: Mapping, timing: Timing) -> tuple[str, ...]:
    notes = []
    measured = [name for name, joint in mapping.joints.items() if joint.velocity]
    if measured and len(measured) < len(mapping.joints):
        without = [name for name in mapping.joints if name not in measured]
        notes.append(f"qvel is left out: joint {without[0]} has no velocity in the map")
    notes += [
        f"joint {name}: world {joint.axes.world}, body {joint.axes.body}, linear velocity in the {joint.axes.linear}'s "
        f"axes and angular in the {joint.axes.angular}'s, turned into MuJoCo's"
        for name, joint in mapping.joints.items()
        if joint.axes
    ]
    if timing.longest[0] > 10 * timing.dt:
        notes.append(f"a pause of {timing.longest[0]:.3g} s after {timing.longest[1]}: one command is held across it")
    return tuple(notes)

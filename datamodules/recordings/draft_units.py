"""Units that a draft of a map guesses: from the name, else from the numbers and the joint's range or slope."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datamodules.recordings.check import FAR, SI, TURNS, JointLayout
from datamodules.recordings.draft_names import POSITION, TIME_UNITS, VELOCITY, named_unit, parts_of
from datamodules.recordings.mapping import LONGEST_PERIOD
from datamodules.recordings.units import ANGLE, LENGTH, TIME, TURN, position_unit, velocity_unit

RESOLUTIONS = (
    *(200, 256, 360, 400, 500, 512, 720, 1000, 1024, 2000, 2048, 2500, 3600, 4000, 4096, 5000, 8000, 8192, 10000),
    *(16384, 20000, 32768, 36000, 40000, 65536, 131072, 262144, 524288, 1048576),
)
"""Counts per turn that encoders have."""
USUAL_PERIOD = 0.01
"""Seconds between rows that are likeliest; the unit of times that name none is that which comes nearest."""
EPOCH = {"s": 1.7e9, "ms": 1.7e12, "us": 1.7e15, "ns": 1.7e18}
"""A time of our days since 1970."""


@dataclass(frozen=True)
class Measured:
    """A guessed unit, as a map has it, empty if none is told; further keys of the channel; and why."""

    unit: str
    why: str
    sign: int = 1


def time_unit(name: str, values: np.ndarray, logged: np.ndarray | None = None) -> Measured:
    """The unit of a column of times; ``logged`` are the same rows' log times, ns, if there are any."""
    if logged is not None and len(logged) == len(values) and values[-1] > values[0] and logged[-1] > logged[0]:
        ratio = 1e-9 * float(logged[-1] - logged[0]) / float(values[-1] - values[0])
        unit = min(TIME, key=lambda unit: abs(math.log(ratio / TIME[unit])))
        return Measured(unit, "by the log's own times")
    parts = [part.lower() for part in parts_of(name)]
    for part in reversed(parts):
        if part in TIME_UNITS and (len(part) > 1 or part == parts[-1]):
            return Measured(TIME_UNITS[part], f"{part} in its name")
    middle, period = float(np.median(values)), float(np.median(np.diff(values.astype(float))))
    for unit, now in EPOCH.items():
        if 0.5 < middle / now < 2 and period * TIME[unit] < LONGEST_PERIOD:
            return Measured(unit, f"as {unit} it is a date of our days")
    if period <= 0:
        return Measured("s", "")
    nearest = min(TIME, key=lambda unit: abs(math.log(period * TIME[unit] / USUAL_PERIOD)))
    if values.dtype.kind == "f" and not np.all(values == np.round(values)) and period < 5:
        nearest = "s"
    return Measured(nearest, f"rows are then {period * TIME[nearest]:.3g} s apart")


def position_measure(name: str, values: np.ndarray, joint: JointLayout, slope: tuple[float, float]) -> Measured:
    """The unit of a position.

    Args:
        name: of the column.
        values: of the column (rows,).
        joint: it is of, a hinge or a slide.
        slope: correlation of the column's slope with the joint's velocity in the model's unit, and how many times as
            large the velocity is; (0, 0) where that is not known.
    """
    unit, word = named_unit(name, POSITION)
    if unit == "counts" or (not unit and joint.type == "hinge" and _looks_like_counts(values, joint)):
        told = f"{word} in its name" if word else "whole numbers"
        return _counts(told, values, slope)
    if unit:
        return Measured(unit, f"{word} in its name")
    units = ANGLE if joint.type == "hinge" else LENGTH
    if abs(slope[0]) > 0.7:
        for unit, factor in units.items():
            if 1 / 1.15 < slope[1] / factor < 1.15:
                return Measured(unit, f"as {unit} its slope is the velocity")
    for unit in ("rad", "deg") if joint.type == "hinge" else ("m", "mm"):
        if _fits(values * position_unit(unit, "").factor, joint):
            return Measured(unit, f"fits the model as {unit}")
    return Measured("", "no unit fits the joint's range")


def _fits(values: np.ndarray, joint: JointLayout) -> bool:
    span = float(np.nanmax(values) - np.nanmin(values))
    if joint.range is None:
        return span <= (TURNS * TURN if joint.type == "hinge" else FAR)
    low, high = joint.range
    room = 0.5 * (high - low)
    return bool(np.nanmin(values) >= low - room and np.nanmax(values) <= high + room)


def _looks_like_counts(values: np.ndarray, joint: JointLayout) -> bool:
    """Whole numbers that are too large to be degrees."""
    whole = bool(np.all(values == np.round(values)))
    return whole and float(np.nanmax(np.abs(values))) > 360 and not _fits(np.deg2rad(values), joint)


def _counts(told: str, values: np.ndarray, slope: tuple[float, float]) -> Measured:
    """``counts:<per turn>``, from the velocity if there is one."""
    if abs(slope[0]) > 0.7 and slope[1] > 0:
        measured = TURN / slope[1]
        nearest = min(RESOLUTIONS, key=lambda n: abs(math.log(n / measured)))
        counts = nearest if abs(nearest / measured - 1) < 0.1 else max(round(measured), 1)
        return Measured(f"counts:{counts}", f"{told}; as {counts} a turn its slope is the velocity")
    most = float(np.nanmax(np.abs(values)))
    counts = next((n for n in (1024, 2048, 4096, 8192, 16384, 65536) if n > most), 4096)
    return Measured(f"counts:{counts}", f"{told}; {counts} A TURN IS NO MORE THAN A GUESS, see the encoder")


def velocity_measure(name: str, joint: JointLayout, slope: tuple[float, float]) -> Measured:
    """The unit and, relative to the position, the sign of a velocity.

    Args:
        name: of the column.
        joint: it is of, a hinge or a slide.
        slope: correlation of the column with the slope of the position in the model's unit, and how many times as large
            that slope is; (0, 0) where that is not known.
    """
    sign = -1 if slope[0] < -0.5 else 1
    turned = "; it runs against the position's slope" if sign == -1 else ""
    unit, word = named_unit(name, VELOCITY)
    if unit and unit != "counts":
        return Measured(unit, f"{word} in its name{turned}", sign)
    si = f"{SI[joint.type]}/s"
    known = (si, "deg/s", "rpm", "rev/s") if joint.type == "hinge" else (si, "mm/s", "cm/s")
    if abs(slope[0]) > 0.5 and slope[1] > 0:
        for unit in known:
            if 1 / 1.25 < slope[1] / velocity_unit(unit, "").factor < 1.25:
                return Measured(unit, f"as {unit} it is the position's slope{turned}", sign)
    return Measured(si, f"no unit in its name{turned}", sign)


def slope_of(times: np.ndarray, positions: np.ndarray, velocities: np.ndarray) -> tuple[float, float]:
    """Correlation of a position's slope with a velocity, and how many times as large the velocity is; (0, 0) if none.

    Args:
        times: of the rows (rows,), s.
        positions: in any unit (rows,).
        velocities: in any unit; of another length they tell nothing.
    """
    if not len(times) == len(positions) == len(velocities) or len(times) < 8:
        return 0.0, 0.0
    rises = np.concatenate([[True], np.diff(times) > 0])
    t, q, v = times[rises], positions[rises].astype(float), velocities[rises].astype(float)
    with np.errstate(all="ignore"):
        slope = np.gradient(q, t)
        sizes = float(np.linalg.norm(slope)), float(np.linalg.norm(v))
        if not all(map(math.isfinite, sizes)) or min(sizes) == 0:
            return 0.0, 0.0
        return float(slope @ v) / (sizes[0] * sizes[1]), sizes[1] / sizes[0]

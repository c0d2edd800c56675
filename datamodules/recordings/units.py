"""Units that recordings come in, each as a factor to the SI unit that MuJoCo models use."""

from __future__ import annotations

import math
from dataclasses import dataclass

from datamodules.recordings.errors import RecordingError, choices

TURN = 2 * math.pi

TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLE = {"rad": 1.0, "deg": TURN / 360, "rev": TURN}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
OTHER = {
    **{"N": ("N", 1.0), "Nm": ("N m", 1.0), "N m": ("N m", 1.0), "mNm": ("N m", 1e-3), "Ncm": ("N m", 1e-2)},
    **{"V": ("V", 1.0), "mV": ("V", 1e-3), "A": ("A", 1.0), "mA": ("A", 1e-3), "%": ("1", 1e-2), "1": ("1", 1.0)},
}
"""What actuators are commanded in, beside positions and velocities: name to SI unit and factor."""


@dataclass(frozen=True)
class Unit:
    """A unit: value [``si``] = ``factor`` times the number in the recording.

    Attributes:
        name: as the map has it; empty where the map names none, then the numbers are taken as they are.
        si: the unit they become, empty where none is known.
        factor: number of ``si`` in one.
    """

    name: str = ""
    si: str = ""
    factor: float = 1.0


def position_unit(name: str, where: str) -> Unit:
    """A joint position's unit: an angle, a length or ``counts:<per rev>``; ``where`` is its place in the map.

    Raises:
        RecordingError: naming the place and the units there are.
    """
    if name.startswith("counts:"):
        return Unit(name, "rad", TURN / _counts(name, where))
    for si, table in (("rad", ANGLE), ("m", LENGTH)):
        if name in table:
            return Unit(name, si, table[name])
    known = [*ANGLE, *LENGTH, "counts:<counts per revolution>"]
    raise RecordingError(f"{where}: unknown unit {name!r}; " + choices(name, known, "units are"))


def velocity_unit(name: str, where: str) -> Unit:
    """A joint velocity's unit: a position's, with or without ``/s``, or ``rpm``.

    Raises:
        RecordingError: naming the place and the units there are.
    """
    if name == "rpm":
        return Unit(name, "rad/s", TURN / 60)
    try:
        unit = position_unit(name.removesuffix("/s"), where)
    except RecordingError:
        known = [*(f"{u}/s" for u in (*ANGLE, *LENGTH)), "rpm", "counts:<counts per revolution>/s"]
        raise RecordingError(f"{where}: unknown unit {name!r}; " + choices(name, known, "units are")) from None
    return Unit(name, f"{unit.si}/s", unit.factor)


def actuator_unit(name: str, where: str) -> Unit:
    """A command's unit: force, torque, voltage, current, a share, a position or a velocity.

    Raises:
        RecordingError: naming the place and the units there are.
    """
    if name in OTHER:
        si, factor = OTHER[name]
        return Unit(name, si, factor)
    try:
        return velocity_unit(name, where) if name.endswith("/s") or name == "rpm" else position_unit(name, where)
    except RecordingError:
        known = [*OTHER, *ANGLE, *LENGTH, "rad/s", "deg/s", "rpm", "m/s", "counts:<counts per revolution>"]
        raise RecordingError(
            f"{where}: unknown unit {name!r} (other units: convert with scale); " + choices(name, known, "units are")
        ) from None


def _counts(name: str, where: str) -> float:
    try:
        counts = float(name.removeprefix("counts:"))
    except ValueError:
        counts = 0.0
    if not (counts > 0 and math.isfinite(counts)):
        raise RecordingError(f"{where}: unit {name!r}: expected counts:<counts per revolution>, such as counts:4096")
    return counts

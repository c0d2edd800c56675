"""Units that recordings are mistaken in: the only factors that a deployment fault may have."""

from __future__ import annotations

import numpy as np

ANGLES = {
    "degrees": np.pi / 180,
    "degrees taken for rad twice": 180 / np.pi,
    "turns": 2 * np.pi,
    "mrad": 1e-3,
} | {f"counts of {2**bits} a turn": 2 * np.pi / 2**bits for bits in (10, 11, 12, 13, 14, 16, 18)}
"""Factor from what a joint's angle may have been written in to rad."""

LENGTHS = {"mm": 1e-3, "cm": 1e-2}
"""Likewise to m."""

SPEEDS = ANGLES | {"rpm": 2 * np.pi / 60}
"""Likewise of a speed to rad/s."""

FORCES = {"thousandths": 1e-3, "per cent": 1e-2}
"""Likewise of a motor's command to its share of the largest; that of a servo is an angle or a speed."""

UNIT_TOLERANCE = 1.4
"""A measured factor may be off by so much from that of a unit: there may be an effect beside it."""

PERIODS = (1e-3, 1e-2, 0.1, 0.2, 0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0, 5.0, 10.0, 100.0, 1e3)
"""Usual factors between a control period and what it was taken for."""


def nearest_unit(factor: float, units: dict[str, float], tolerance: float = UNIT_TOLERANCE) -> tuple[str, float] | None:
    """The unit whose factor is nearest to a measured one, and that factor; None where none is near.

    A factor that is nearer to 1 than to any unit is none of a unit.
    """
    if not np.isfinite(factor) or factor <= 0:
        return None
    every = [("", 1.0), *units.items()]
    name, value = min(every, key=lambda entry: abs(np.log(factor / entry[1])))
    near = abs(np.log(factor / value)) < np.log(tolerance)
    return (name, value) if name and near else None


def usual_period(factor: float, tolerance: float = 1.12) -> float:
    """A usual factor of a control period, if one is near; else the factor itself, with three digits."""
    near = min(PERIODS, key=lambda p: abs(np.log(factor / p)))
    return near if abs(np.log(factor / near)) < np.log(tolerance) else float(f"{factor:.3g}")

"""Doubts about a floating body's axes: whether its velocities are the slopes of its positions, and if not, why."""

from __future__ import annotations

import numpy as np

from datamodules.recordings.axes import into_z_up, rotations

AGREES, DIFFERS = 0.9, 0.7
"""Cosines between velocities and slopes, over all rows and axes: from the one on an explanation holds, below the other
there is a doubt."""
FACTOR = 3.0
"""A velocity that is so many times its slope, or less than one such part, has another unit."""
MOVES = 0.1
"""What moves less, m/s or rad/s, is noise to a slow log."""


def floating_doubts(name: str, positions: np.ndarray, velocities: np.ndarray, times: np.ndarray) -> list[str]:
    """What to ask of a free or ball joint whose velocities are not its positions' slopes.

    Args:
        name: of the joint.
        positions: in MuJoCo's axes, (T+1, 7 or 4).
        velocities: likewise, (T+1, 6 or 3).
        times: of the rows, s, (T+1,).
    """
    periods, mean = np.diff(times)[:, None], (velocities[1:] + velocities[:-1]) / 2
    body, doubts = rotations(positions[:-1]), []
    if positions.shape[1] == 7:
        slope = np.diff(positions[:, :3], axis=0) / periods
        asked = {
            "is it in the body's axes (axes: {linear: body})?": body.apply(mean[:, :3]),
            "does z point down in one of them?": into_z_up("z_down").apply(mean[:, :3]),
        }
        doubts += _doubt(f"joint {name}: the linear velocity", slope, mean[:, :3], asked)
    turning, quaternions = mean[:, -3:], positions[:, -4:]
    slope = _turning(quaternions, periods)
    asked = {
        "is it in the world's axes (axes: {angular: world})?": body.apply(turning, inverse=True),
        "does z point down in one of them?": into_z_up("z_down").apply(turning),
    }
    if _cosine(_turning(np.roll(quaternions, 1, axis=1), periods), turning) > AGREES > _cosine(slope, turning):
        question = "is the quaternion recorded as x, y, z, w? Name its columns in the order w, x, y, z"
        return [*doubts, f"joint {name}: {question}"]
    return doubts + _doubt(f"joint {name}: the angular velocity", slope, turning, asked)


def _turning(quaternions: np.ndarray, periods: np.ndarray) -> np.ndarray:
    """Angular velocities between rows of quaternions (T+1, 4), in the body's axes, (T, 3)."""
    turned = rotations(quaternions)
    return (turned[:-1].inv() * turned[1:]).as_rotvec() / periods


def _cosine(one: np.ndarray, other: np.ndarray) -> float:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.sum(one * other)) / size if size else 1.0


def _doubt(what: str, slope: np.ndarray, velocity: np.ndarray, asked: dict[str, np.ndarray]) -> list[str]:
    speed = np.sqrt(np.mean(np.sum(slope**2, axis=1)))
    if speed < MOVES:
        return []
    if _cosine(slope, velocity) >= DIFFERS:
        times = float(np.sqrt(np.mean(np.sum(velocity**2, axis=1))) / speed)
        unit = f"{what} is {times:.3g} times the slope of the positions: is a unit wrong, as of angles or rates?"
        return [] if 1 / FACTOR < times < FACTOR else [unit]
    likely = [question for question, turned in asked.items() if _cosine(slope, turned) > AGREES]
    return [f"{what} is not the slope of the positions: " + (likely or ["are columns, signs or units wrong?"])[0]]

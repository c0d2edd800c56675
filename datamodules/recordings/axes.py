"""Axes of floating bodies: recordings in which z points down, or velocities are the body's, into MuJoCo's.

MuJoCo has z up in the world. A free joint's position is 3 coordinates and a quaternion (w, x, y, z) that turns the
body's axes into the world's; its velocity is linear in the world's axes and angular in the body's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from datamodules.recordings.errors import RecordingError, choices

ABOUT_X: Mapping[str, float] = MappingProxyType({"z_up": 0.0, "z_down": 180.0, "y_up": 90.0})
"""By so many degrees about x axes are turned into such with z up."""
ALSO = {"ned": "z_down", "frd": "z_down", "enu": "z_up", "nwu": "z_up", "flu": "z_up"}
"""Other names that autopilots and ROS have for them."""
AXES_KEYS = {
    "world": (*ABOUT_X, "ned", "enu", "nwu"),
    "body": (*ABOUT_X, "frd", "flu"),
    "linear": ("world", "body"),
    "angular": ("body", "world"),
    "rates": ("rad/s", "deg/s"),
    "angles": ("rad", "deg"),
    "pitch": ("about_y", "reversed"),
}
"""What a map may say; MuJoCo's own come first, and no angles."""
ANGLES = 3
"""Roll, pitch and yaw stand in place of a quaternion's 4 columns."""
NO_ROTATION = 0.05
"""A quaternion's length may differ from 1 by this."""


@dataclass(frozen=True)
class Axes:
    """In which axes a ball or free joint was recorded.

    Attributes:
        world: the world's, one of ``ABOUT_X``.
        body: the body's, likewise.
        linear: whose axes the linear velocity is in.
        angular: whose the angular velocity is in.
        rates: its unit.
        angles: unit of roll, pitch and yaw in place of a quaternion; empty where there is one.
        pitch: ``reversed`` if it grows against the right hand about y.
    """

    world: str = "z_up"
    body: str = "z_up"
    linear: str = "world"
    angular: str = "body"
    rates: str = "rad/s"
    angles: str = ""
    pitch: str = "about_y"

    def with_quaternions(self, recorded: np.ndarray) -> np.ndarray:
        """Rows (n, 7) or (n, 4), of rows that may have roll, pitch and yaw, (n, 6) or (n, 3), as in aircraft.

        The body is turned about its z by yaw, then about its new y by pitch, then about its new x by roll.
        """
        if not self.angles:
            return recorded
        roll, pitch, yaw = recorded[:, -ANGLES:].T
        turned = np.column_stack([yaw, -pitch if self.pitch == "reversed" else pitch, roll])
        quaternions = Rotation.from_euler("ZYX", turned, degrees=self.angles == "deg").as_quat()
        return np.hstack([recorded[:, :-ANGLES], np.roll(quaternions, 1, axis=1)])

    def position(self, recorded: np.ndarray) -> np.ndarray:
        """Rows (n, 7) of a free joint, or (n, 4) of a ball joint, in MuJoCo's axes; with quaternions."""
        place, turned = recorded[:, :-4], into_z_up(self.world) * rotations(recorded) * into_z_up(self.body).inv()
        quaternions = np.roll(turned.as_quat(), 1, axis=1)
        if place.size:
            place = into_z_up(self.world).apply(place)
        return np.hstack([place, in_a_row(quaternions)])

    def velocity(self, recorded: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Rows (n, 6) of a free joint, or (n, 3) of a ball joint, in MuJoCo's axes; positions have quaternions."""
        linear, angular, out_of_body = recorded[:, :-3], recorded[:, -3:], rotations(positions)
        if linear.size:
            linear = into_z_up(self.world).apply(out_of_body.apply(linear) if self.linear == "body" else linear)
        angular = np.radians(angular) if self.rates == "deg/s" else angular
        angular = out_of_body.apply(angular, inverse=True) if self.angular == "world" else angular
        return np.hstack([linear, into_z_up(self.body).apply(angular)])


def into_z_up(axes: str) -> Rotation:
    """The rotation of such axes into those with z up."""
    return Rotation.from_euler("x", ABOUT_X[axes], degrees=True)


def rotations(positions: np.ndarray) -> Rotation:
    """Of positions whose last 4 columns are quaternions (w, x, y, z)."""
    return Rotation.from_quat(np.roll(positions[:, -4:], -1, axis=1))


def in_a_row(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (n, 4) with signs that do not jump, as q and -q are one rotation; the first begins with w >= 0."""
    turned = np.concatenate([quaternions[:1, 0], np.sum(quaternions[1:] * quaternions[:-1], axis=1)]) < 0
    return np.cumprod(np.where(turned, -1.0, 1.0))[:, None] * quaternions


def no_rotation(quaternions: np.ndarray) -> int | None:
    """The first row (n, 4) that is no rotation, by its length; None if all are."""
    wrong = np.flatnonzero(~(np.abs(np.linalg.norm(quaternions, axis=1) - 1) <= NO_ROTATION))
    return int(wrong[0]) if len(wrong) else None


def has_angles(axes: object) -> bool:
    """Whether a map's ``axes`` say that a joint has roll, pitch and yaw."""
    return isinstance(axes, dict) and "angles" in axes


def parse_axes(key: str, value: object, columns: int, velocities: int | None) -> Axes:
    """What a map says of a joint's axes.

    Args:
        key: in the map, for messages.
        value: of the key.
        columns: of the joint's position.
        velocities: columns of its velocity; None if it has none.

    Raises:
        RecordingError: naming the key, what was expected and what came.
    """
    if not isinstance(value, dict):
        raise RecordingError(f"{key}: expected keys among {', '.join(AXES_KEYS)}; got {value!r}")
    angles = has_angles(value)
    if columns not in ((3, 6) if angles else (4, 7)):
        takes = "3 or 6 columns with roll, pitch and yaw" if angles else "4 or 7 columns"
        raise RecordingError(f"{key}: axes are of ball and free joints, which take {takes}; got {columns}")
    moves = columns if angles else columns - 1
    if velocities not in (None, moves):
        raise RecordingError(f"{key}: expected {moves} columns of the velocity beside it, got {velocities}")
    said: dict[str, str] = {}
    for name, word in value.items():
        if name not in AXES_KEYS:
            raise RecordingError(f"{key}: unknown key {name!r}; " + choices(str(name), AXES_KEYS, "keys are"))
        if word not in AXES_KEYS[name]:
            raise RecordingError(f"{key}.{name}: got {word!r}; " + choices(str(word), AXES_KEYS[name], "it may be"))
        said[name] = ALSO.get(str(word), str(word))
    return Axes(**said)

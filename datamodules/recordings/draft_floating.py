"""A floating body in a draft of a map: its columns by the names that autopilots, ROS and logs of simulators have."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Naming:
    """How somebody names the columns of a floating body; all may have something before them.

    Attributes:
        whose: for the comment.
        position: of 3 coordinates and a quaternion (w, x, y, z), or roll, pitch and yaw.
        velocities: of the linear and angular velocity, alternatives; none where they are not recorded beside it.
        axes: in which they are, where these are not MuJoCo's; units of angles that names do not tell are left out.
        motors: what the names of commands to motors begin with, from the first on; commands go from 0 to 1.
    """

    whose: str
    position: tuple[str, ...]
    velocities: tuple[tuple[str, ...], ...] = ()
    axes: dict[str, str] = field(default_factory=dict)
    motors: str = ""


@dataclass(frozen=True)
class FloatingColumns:
    """Columns of a floating body: positions (7, or 6), velocities (6, or none), their axes; its motors'."""

    position: tuple[str, ...]
    velocity: tuple[str, ...]
    axes: dict[str, str]
    motors: tuple[str, ...]
    why: str


def _ros(place: str, rotation: str, twist: str = "") -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    position = (*(f"{place}.{axis}" for axis in "xyz"), *(f"{rotation}.{axis}" for axis in "wxyz"))
    velocity = tuple(f"{twist}.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")
    return position, (velocity,) if twist else ()


_LOCAL = "vehicle_local_position"
_ANGLES = ("roll", "pitch", "yaw")
_PLAIN = tuple(("vx", "vy", "vz", *turning) for turning in (("wx", "wy", "wz"), ("p", "q", "r")))
NAMINGS = (
    Naming(
        "PX4's",
        (*(f"{_LOCAL}.{axis}" for axis in "xyz"), *(f"vehicle_attitude.q[{i}]" for i in range(4))),
        tuple(
            (*(f"{_LOCAL}.v{axis}" for axis in "xyz"), *turning)
            for turning in (
                tuple(f"vehicle_angular_velocity.xyz[{i}]" for i in range(3)),
                tuple(f"vehicle_attitude.{axis}speed" for axis in ("roll", "pitch", "yaw")),
            )
        ),
        {"world": "ned", "body": "frd"},
        "actuator_motors.control",
    ),
    Naming(
        "of ROS's Odometry",
        *_ros("pose.pose.position", "pose.pose.orientation", "twist.twist"),
        {"linear": "body"},
    ),
    Naming("of ROS's PoseStamped", *_ros("pose.position", "pose.orientation")),
    Naming("of ROS's TransformStamped", *_ros("transform.translation", "transform.rotation")),
    Naming(
        "MAVLink's",
        (*(f"local_position_ned.{axis}" for axis in "xyz"), *(f"attitude.{angle}" for angle in _ANGLES)),
        ((*(f"local_position_ned.v{axis}" for axis in "xyz"), *(f"attitude.{angle}speed" for angle in _ANGLES)),),
        {"world": "ned", "body": "frd", "angles": "rad"},
    ),
    Naming(
        "the Crazyflie's",
        tuple(f"stateestimate.{name}" for name in (*"xyz", *_ANGLES)),
        ((*(f"stateestimate.v{axis}" for axis in "xyz"), *(f"gyro.{axis}" for axis in "xyz")),),
        {"angles": "deg", "rates": "deg/s", "pitch": "reversed"},
    ),
    Naming("usual ones", ("x", "y", "z", "qw", "qx", "qy", "qz"), _PLAIN),
    Naming("usual ones", ("x", "y", "z", *_ANGLES), _PLAIN),
)
"""The first that fits is taken."""
LARGEST_ANGLE = 6.5
"""Roll, pitch or yaw beyond it are degrees, as one turn has 6.28 rad."""


def floating_columns(columns: Iterable[str]) -> FloatingColumns | None:
    """The columns of the one floating body that a recording has; None where there is none, or are several."""
    known = {_plain(name): name for name in columns}
    for naming in NAMINGS:
        first = naming.position[0]
        before = [name.removesuffix(first) for name in known if name.endswith(first)]
        found = [b for b in before if all(b + name in known for name in naming.position)]
        if len(found) == 1:
            (b,) = found
            measured = [v for v in naming.velocities if all(b + name in known for name in v)]
            velocity = tuple(known[b + name] for name in measured[0]) if measured else ()
            position = tuple(known[b + name] for name in naming.position)
            driven = itertools.takewhile(known.__contains__, (f"{b}{naming.motors}[{i}]" for i in itertools.count()))
            motors = tuple(known[name] for name in driven)
            return FloatingColumns(position, velocity, naming.axes, motors, f"the names are {naming.whose}")
    return None


def with_unit_of_angles(found: FloatingColumns, columns: Mapping[str, np.ndarray]) -> tuple[dict[str, str], str]:
    """What a map says of the axes, and why; a unit of angles that names do not tell is guessed from their size."""
    if len(found.position) == 7 or "angles" in found.axes:
        return found.axes, "as usual with such names"
    size = max(float(np.nanmax(np.abs(columns[name]))) for name in found.position[-len(_ANGLES) :])
    unit = "deg" if size > LARGEST_ANGLE else "rad"
    return {**found.axes, "angles": unit}, f"BY THEIR SIZE ONLY, up to {size:.3g}"


def _plain(name: str) -> str:
    """With points between its parts, as topics' fields have them; some programs write slashes."""
    return name.replace("/", ".").lower()

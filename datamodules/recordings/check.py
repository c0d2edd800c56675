"""A map and what came of it against a model: names, order, shapes, and whether units and signs can be right.

MuJoCo is not needed here: a ``ModelLayout`` has what the checks ask of a model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datamodules.recordings.axes_doubts import floating_doubts
from datamodules.recordings.convert import Imported
from datamodules.recordings.errors import RecordingError, choices, listing
from datamodules.recordings.mapping import Channel, Joint, Mapping

WIDTHS = {"hinge": (1, 1), "slide": (1, 1), "ball": (4, 3), "free": (7, 6)}
"""Numbers in qpos and in qvel of a joint, by its type."""

SI = {"hinge": "rad", "slide": "m"}
FAR = 10
"""A joint that moves over so many times its range is in another unit."""
TURNS = 4
"""A hinge without limits that moves over more turns than this may be in degrees."""


@dataclass(frozen=True)
class JointLayout:
    """A joint of a model: name, type (a key of ``WIDTHS``) and range [rad or m], None without limits."""

    name: str
    type: str
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class ActuatorLayout:
    """An actuator of a model.

    Attributes:
        name: its name.
        range: of its control, or of what its joint's effort limit lets a motor do; None without limits.
        joint: that it drives, empty if it drives something else.
        force: whether its command is a force or torque, not the target of a servo.
    """

    name: str
    range: tuple[float, float] | None = None
    joint: str = ""
    force: bool = False


@dataclass(frozen=True)
class ModelLayout:
    """What of a model a recording is checked against.

    Attributes:
        name: the model's file, for messages.
        joints: in qpos order.
        actuators: in the order of ctrl.
    """

    name: str
    joints: tuple[JointLayout, ...]
    actuators: tuple[ActuatorLayout, ...]


def fit_to_model(mapping: Mapping, model: ModelLayout) -> Mapping:
    """The map with joints and actuators in the model's order; each must be there, with the right unit and width.

    Raises:
        RecordingError: naming the map, the key and the model's names.
    """
    kinds: list[tuple[str, dict, tuple]] = [("actuator", mapping.actuators, model.actuators)]
    if mapping.joints:  # else there are images alone
        kinds.insert(0, ("joint", mapping.joints, model.joints))
    for kind, mapped, layouts in kinds:
        _check_names(mapping, kind, mapped, [layout.name for layout in layouts], model.name)
    joints = {j.name: _fit_joint(mapping, mapping.joints[j.name], j) for j in model.joints if mapping.joints}
    return replace(mapping, joints=joints, actuators={a.name: mapping.actuators[a.name] for a in model.actuators})


def _check_names(mapping: Mapping, kind: str, mapped: dict, known: list[str], model: str) -> None:
    for name in mapped:
        if name not in known:
            raise RecordingError(
                f"{mapping.source}: {kind}s.{name}: {model} has no such {kind}; "
                + (choices(name, known, f"its {kind}s are") if known else f"it has no {kind}s")
                + (
                    "; say what drives it, --actuators motor or position:kp=..,kv=.."
                    if kind == "actuator" and not known
                    else ""
                )
            )
    if missing := [name for name in known if name not in mapped]:
        raise RecordingError(
            f"{mapping.source}: {kind}s: {listing(missing)} of {model} is not mapped; name its column, or say "
            + ("{position: {constant: 0}, velocity: {constant: 0}}" if kind == "joint" else "{constant: 0}")
            + " if it never moved"
            + (" or give a model without actuators, if nothing was driven" if kind == "actuator" else "")
        )


def _fit_joint(mapping: Mapping, joint: Joint, layout: JointLayout) -> Joint:
    nq, nv = WIDTHS[layout.type]
    position = _fit_channel(mapping, joint.position, layout, nv if joint.axes and joint.axes.angles else nq, "")
    velocity = None if joint.velocity is None else _fit_channel(mapping, joint.velocity, layout, nv, "/s")
    return replace(joint, position=position, velocity=velocity)


def _fit_channel(mapping: Mapping, channel: Channel, layout: JointLayout, width: int, per: str) -> Channel:
    """The channel, checked for its width, with the unit that the joint's type says where the map says none."""
    if layout.type in SI:  # it has one column, so that a list names alternatives, however long it is
        channel = replace(channel, columns=channel.columns[:1], others=channel.columns[1:] + channel.others)
    columns = max(len(channel.columns), 1)
    if columns != width:
        raise RecordingError(
            f"{mapping.source}: {channel.key}: a {layout.type} joint takes {width} columns, got {columns}"
        )
    if layout.type not in SI:
        return channel
    si = SI[layout.type] + per
    if channel.unit.si not in ("", si):
        raise RecordingError(
            f"{mapping.source}: {channel.key}: joint {layout.name} is a {layout.type} joint, in {si}; "
            f"got unit {channel.unit.name}"
        )
    return replace(channel, unit=replace(channel.unit, si=si))


# --- whether the numbers can be right -------------------------------------------------------------------


def check_against_model(imported: Imported, model: ModelLayout) -> tuple[str, ...]:
    """Doubts about units, signs and offsets, from the model's ranges.

    Raises:
        RecordingError: if a joint moves over 10 times its range.
    """
    qpos = [e.observations["qpos"] for e in imported.trajectories if "qpos" in e.observations]
    actions = np.concatenate([e.actions for e in imported.trajectories])
    notes, column = [], 0
    for joint in model.joints if qpos else ():
        if joint.type in SI:
            notes += _joint_doubts(joint, np.concatenate(qpos)[:, column], model.name)
        column += WIDTHS[joint.type][0]
    for actuator, values in zip(model.actuators, actions.T, strict=True):
        notes += _actuator_doubts(actuator, values)
    return tuple(notes)


def _joint_doubts(joint: JointLayout, values: np.ndarray, model: str) -> list[str]:
    si, span = SI[joint.type], float(np.ptp(values))
    moves = f"joint {joint.name} moves over {span:.4g} {si}"
    question = "are the units degrees (unit: deg)?" if joint.type == "hinge" else "are the units mm (unit: mm)?"
    if joint.range is None:
        turns = span / (2 * np.pi)
        if joint.type == "hinge" and turns > TURNS:
            return [f"{moves}, {turns:.3g} turns: {question}"]
        return [f"{moves}: {question}"] if joint.type == "slide" and span > 100 else []
    low, high = joint.range
    allowed = f"its range in {model}, {low:.4g} to {high:.4g} {si}"
    if span > FAR * (high - low):
        raise RecordingError(f"{moves}, over {FAR} times {allowed}: {question} If they are right, correct the range")
    if values.min() < low - 0.05 * (high - low) or values.max() > high + 0.05 * (high - low):
        came = f"{values.min():.4g} to {values.max():.4g} {si}"
        doubt = question if span > high - low else "is the offset or the sign wrong?"
        return [f"joint {joint.name} goes from {came}, beyond {allowed}: {doubt}"]
    return []


def _actuator_doubts(actuator: ActuatorLayout, values: np.ndarray) -> list[str]:
    if actuator.range is None or not len(values):
        return []
    low, high = actuator.range
    beyond = float(np.mean((values < low - 0.01 * (high - low)) | (values > high + 0.01 * (high - low))))
    if not beyond:
        return []
    return [
        f"actuator {actuator.name} is commanded {values.min():.4g} to {values.max():.4g}, {beyond:.0%} of the time "
        f"beyond its control range {low:.4g} to {high:.4g}, where MuJoCo clamps it: is the unit right?"
    ]


def check_velocities(imported: Imported, mapping: Mapping) -> tuple[str, ...]:
    """Doubts about velocities whose sign or size is not that of the positions' slope; no model is needed."""
    episodes, dt = imported.trajectories.episodes, imported.trajectories.dt
    if "qvel" not in episodes[0].observations:
        return ()
    times = [np.arange(len(e) + 1) * dt if e.timestamps is None else e.timestamps for e in episodes]
    longest = max(range(len(episodes)), key=lambda i: len(episodes[i]))
    notes, q, v = [], 0, 0
    for (name, joint), velocity in zip(mapping.joints.items(), mapping.velocities, strict=True):
        nq, nv = len(joint.position_columns), max(len(velocity.columns), 1)
        positions = [e.observations["qpos"][:, q : q + nq] for e in episodes]
        velocities = [e.observations["qvel"][:, v : v + nv] for e in episodes]
        if nq > 1 and (nq, nv) in WIDTHS.values():
            notes += floating_doubts(name, positions[longest], velocities[longest], times[longest])
        elif nq == nv:
            slopes = [np.gradient(p[:, 0], t) for p, t in zip(positions, times, strict=True)]
            notes += _velocity_doubts(name, np.concatenate(slopes), np.concatenate(velocities)[:, 0])
        q, v = q + nq, v + nv
    return tuple(notes)


def _velocity_doubts(name: str, slope: np.ndarray, velocity: np.ndarray) -> list[str]:
    sizes = np.linalg.norm(slope), np.linalg.norm(velocity)
    if min(sizes) == 0:
        return []
    correlation, ratio = float(slope @ velocity) / (sizes[0] * sizes[1]), sizes[1] / sizes[0]
    if correlation < -0.5:
        return [f"joint {name}: the velocity has the opposite sign of the position's slope: is a sign wrong?"]
    if correlation > 0.5 and not 1 / 3 < ratio < 3:
        return [f"joint {name}: the velocity is {ratio:.3g} times the position's slope: is a unit wrong?"]
    return []

"""What a motion may do: positions, velocities, commands and forces, contacts, height."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.candidate import scalar_joints

TURN = 2 * np.pi
"""Rad (of a slide m), of which a margin is at most a share."""

Span = tuple[float, float]
"""Lowest and highest value."""


class ImpossibleMotion(ValueError):
    """The limits, the model or the report allow no motion; the message says which and what to do."""


@dataclass(frozen=True)
class MotionLimits:
    """Bounds of a motion; infinite where there are none.

    Attributes:
        position: of every degree of freedom of a hinge or slide, rad or m, (nv, 2).
        velocity: greatest speed of every degree of freedom, rad/s or m/s, (nv,).
        command: in the actuators' units, (nu, 2).
        force: of the actuators, before the gear, N·m or N, (nu, 2).
        no_contact: nothing may touch that does not touch at the start.
        lowest: height that no moving geom may go below, m; None for any.
    """

    position: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    force: np.ndarray
    no_contact: bool = True
    lowest: float | None = None

    def to_dict(self, model: mujoco.MjModel) -> dict:
        """As in ``next.json``, by name; what has no limit is left out."""
        joints = {name: v for _, v, name in scalar_joints(model)}
        actuators = {model.actuator(i).name: i for i in range(model.nu)}
        return {
            "position": {n: span_as_list(self.position[v]) for n, v in joints.items() if bounded(self.position[v])},
            "velocity": {n: float(self.velocity[v]) for n, v in joints.items() if np.isfinite(self.velocity[v])},
            "command": {n: span_as_list(self.command[i]) for n, i in actuators.items()},
            "force": {n: span_as_list(self.force[i]) for n, i in actuators.items() if bounded(self.force[i])},
            "no_contact": self.no_contact,
            "lowest_m": self.lowest,
        }


def bounded(span: np.ndarray) -> bool:
    """Whether there is a limit to either side."""
    return bool(np.isfinite(span).any())


def span_as_list(span: np.ndarray) -> list[float | None]:
    """A span for JSON, which knows no infinity."""
    return [float(v) if np.isfinite(v) else None for v in span]


def limits_of(
    model: mujoco.MjModel,
    position: Mapping[str, Span] | None = None,
    velocity: Mapping[str, Span] | None = None,
    command: Mapping[str, Span] | None = None,
    force: Mapping[str, Span] | None = None,
    no_contact: bool = True,
    lowest: float | None = None,
    margin: float = 0.05,
) -> MotionLimits:
    """Limits of a model, narrowed by those given.

    Args:
        model: joint ranges, ``ctrlrange`` and ``forcerange`` are taken from it. A servo without a ``ctrlrange`` has its
            joint's range.
        position: by the joint's name, ``"*"`` for all; of hinges and slides.
        velocity: greatest speeds likewise; the higher value of each span counts.
        command: by the actuator's name, ``"*"`` for all.
        force: likewise, of the actuators' forces.
        no_contact: nothing may touch that does not touch at the start.
        lowest: height that no moving geom may go below, m.
        margin: share of the model's own ranges that is kept free at either end. What happens to an offset command at
            the end of its range is convention, and joint stops are hard on machines.

    Raises:
        ImpossibleMotion: a name is not in the model, limits exclude each other, or an actuator has none.
    """
    joints = {name: v for _, v, name in scalar_joints(model)}
    actuators = {model.actuator(i).name: i for i in range(model.nu)}
    if not actuators:
        raise ImpossibleMotion("the model has no actuators, so there is nothing to command")
    positions = narrowed(joint_ranges(model, margin), joints, position, "position")
    speeds = narrowed(np.tile([-np.inf, np.inf], (model.nv, 1)), joints, symmetric(velocity), "velocity")
    commands = narrowed(command_ranges(model, margin), actuators, command, "command")
    forces = narrowed(force_ranges(model), actuators, symmetric(force), "torque")
    if endless := [name for name, i in actuators.items() if not np.isfinite(commands[i]).all()]:
        raise ImpossibleMotion(
            f"no ctrlrange in the model: {', '.join(endless)}. Give lowest and highest commands, --command "
            f"{' '.join(f'{name}=LOW:HIGH' for name in endless)}, or one LOW:HIGH for all"
        )
    return MotionLimits(positions, speeds[:, 1], commands, forces, no_contact, lowest)


def symmetric(spans: Mapping[str, Span] | None) -> dict[str, Span]:
    """Spans to either side of zero, as far as the greater end."""
    return {name: (-max(map(abs, span)), max(map(abs, span))) for name, span in (spans or {}).items()}


def joint_ranges(model: mujoco.MjModel, margin: float) -> np.ndarray:
    """Ranges of the limited hinges and slides without the margin, (nv, 2)."""
    out = np.tile([-np.inf, np.inf], (model.nv, 1))
    for j, v, _ in scalar_joints(model):
        if model.jnt_limited[j]:
            low, high = model.jnt_range[j]
            inside = margin * min(high - low, TURN)  # one end may be open, and so as good as infinitely far
            out[v] = low + inside, high - inside
    return out


def command_ranges(model: mujoco.MjModel, margin: float) -> np.ndarray:
    """Ranges of the commands without the margin, (nu, 2); those of servos lie within their joint's.

    A motor without a ``ctrlrange`` has what its joint bears (``actuatorfrcrange``, the effort limit of a URDF).
    """
    out, joints = np.tile([-np.inf, np.inf], (model.nu, 1)), joint_ranges(model, margin)
    for i in range(model.nu):
        span = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else effort_range(model, i)
        if span is not None:
            low, high = span
            out[i] = low + margin * (high - low), high - margin * (high - low)
        if (v := servo_dof(model, i)) is not None:
            out[i] = max(out[i, 0], joints[v, 0]), min(out[i, 1], joints[v, 1])
    return out


def effort_range(model: mujoco.MjModel, actuator: int) -> np.ndarray | None:
    """Commands of a motor with which its joint gets as much as it bears, (2,); None where that is not said."""
    joint, bias = int(model.actuator_trnid[actuator, 0]), model.actuator_biasprm[actuator, :3]
    factor = model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0]
    on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    linear = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED and not bias.any() and factor
    if not on_joint or not linear or not model.jnt_actfrclimited[joint]:
        return None
    return np.sort(model.jnt_actfrcrange[joint] / factor)


def force_ranges(model: mujoco.MjModel) -> np.ndarray:
    """What the actuators' forces are cut off at in the model, (nu, 2)."""
    limited = model.actuator_forcelimited.astype(bool)[:, None]
    return np.where(limited, model.actuator_forcerange, [-np.inf, np.inf])


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator is told a position, whatever it moves and through whatever gear."""
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator, 1]
    return bool(bias) and bool(np.isclose(gain, -bias))


def servo_dof(model: mujoco.MjModel, actuator: int) -> int | None:
    """The degree of freedom whose position an actuator commands one to one; None for motors and geared servos."""
    on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    if not on_joint or not is_servo(model, actuator) or model.actuator_gear[actuator, 0] != 1.0:
        return None
    joint = int(model.actuator_trnid[actuator, 0])
    return int(model.jnt_dofadr[joint]) if model.jnt_type[joint] >= 2 else None


def narrowed(spans: np.ndarray, names: Mapping[str, int], given: Mapping[str, Span] | None, what: str) -> np.ndarray:
    """Spans, (n, 2), cut to those given by name.

    Raises:
        ImpossibleMotion: an unknown name, or nothing is left between two limits.
    """
    out = spans.copy()
    for name, (low, high) in (given or {}).items():
        if name != "*" and name not in names:
            raise ImpossibleMotion(f"--{what}: the model has no {name!r}; it has: {', '.join(names)}")
        for i in names.values() if name == "*" else [names[name]]:
            out[i] = max(out[i, 0], low), min(out[i, 1], high)
            if out[i, 0] >= out[i, 1]:
                known = next(n for n, k in names.items() if k == i)
                raise ImpossibleMotion(
                    f"--{what}: nothing is left for {known} between {out[i, 0]:.4g} and {out[i, 1]:.4g}; "
                    "widen the limit (the model's own range counts too)"
                )
    return out

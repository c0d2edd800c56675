"""Actuators that a user declares in plain words, for a model that has none: ``motor``, ``position:kp=30,kv=1``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from idapt_pl.files import read_yaml

ACTUATOR_SETTINGS: Mapping[str, Mapping[str, float | None]] = {
    "motor": {"gear": 1.0},
    "position": {"kp": None, "kv": 0.0},
    "velocity": {"kv": None},
}
"""Kinds of actuators, their settings and defaults; None where one must be given."""

ANY_JOINT = "*"
NOTHING = "none"
HOW_TO_DECLARE = "write motor (torques), position:kp=30,kv=1 (targets of servos), velocity:kv=2, none, or a YAML file"


@dataclass(frozen=True)
class DeclaredActuator:
    """One actuator.

    Attributes:
        joint: that it acts on; ``*`` for every joint without one.
        kind: motor, position or velocity.
        settings: of that kind, by name.
    """

    joint: str
    kind: str
    settings: Mapping[str, float] = field(default_factory=dict)


def parse_actuators(text: str) -> tuple[DeclaredActuator, ...]:
    """Actuators of an option: one kind for every joint, or a YAML file with one for each, in the commands' order.

    Raises:
        ValueError: it is neither, or a setting is unknown, missing or no number.
    """
    if text == NOTHING:
        return ()
    kind, _, settings = text.partition(":")
    if kind in ACTUATOR_SETTINGS:
        pairs = [p.partition("=") for p in settings.split(",") if p]
        return (declared(ANY_JOINT, kind, {name.strip(): value for name, _, value in pairs}, f"--actuators {text}"),)
    path = Path(text)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ValueError(f"--actuators {text}: {HOW_TO_DECLARE}")
    if not path.is_file():
        raise ValueError(f"--actuators: {path}: no such file; {HOW_TO_DECLARE}")
    return from_yaml(path)


def from_yaml(path: Path) -> tuple[DeclaredActuator, ...]:
    """Actuators of a file: joints with ``motor``, or with a mapping of ``type`` and settings.

    Raises:
        ValueError: naming the file and the joint.
    """
    entries = read_yaml(path)
    if not isinstance(entries, dict) or not entries:
        raise ValueError(
            f"{path}: expected joints with actuators, as in `elbow: motor` or `elbow: {{type: position, kp: 30}}`"
        )
    made = []
    for joint, entry in entries.items():
        where, settings = f"{path}: {joint}", dict(entry) if isinstance(entry, Mapping) else {"type": entry}
        kind = settings.pop("type", None)
        if kind not in ACTUATOR_SETTINGS:
            raise ValueError(f"{where}: type must be one of {', '.join(ACTUATOR_SETTINGS)}, got {kind!r}")
        made.append(declared(str(joint), str(kind), settings, where))
    return tuple(made)


def declared(joint: str, kind: str, settings: Mapping[str, Any], where: str) -> DeclaredActuator:
    """One actuator, its settings checked.

    Raises:
        ValueError: one is unknown, missing or no number above 0.
    """
    known = ACTUATOR_SETTINGS[kind]
    if unknown := sorted(set(settings) - set(known)):
        raise ValueError(f"{where}: {kind} has no setting {unknown[0]!r}; it has: {', '.join(known)}")
    values = {name: default for name, default in known.items() if default is not None}
    for name, value in settings.items():
        try:
            values[name] = float(value)
        except (TypeError, ValueError):
            raise ValueError(f"{where}: {name} must be a number, got {value!r}") from None
        if not np.isfinite(values[name]) or values[name] < 0:
            raise ValueError(f"{where}: {name} must be 0 or more, got {value}")
    if missing := [n for n in known if n not in values]:
        raise ValueError(f"{where}: {kind} needs {missing[0]}, as in {kind}:{missing[0]}=30")
    return DeclaredActuator(joint, kind, values)


def add_actuators(
    spec: mujoco.MjSpec, actuators: Sequence[DeclaredActuator], where: str, driven: Sequence[str] = ()
) -> list[str]:
    """Give a model actuators; what was given, in sentences.

    Args:
        spec: of the model, edited in place; its joints have names.
        actuators: in the order of the commands; those for ``*`` in the order of the joints.
        where: the model, for messages.
        driven: joints that its file says are driven; if there are any, ``*`` means these.

    Raises:
        ValueError: the model has actuators, a joint is not there or not one that a single command can drive.
    """
    if len(spec.actuators):
        raise ValueError(f"{where}: it has actuators already, so --actuators has nothing to do")
    if not actuators:
        return []
    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    following = {e.name1 for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_JOINT}
    drivable = {j.name: j for j in spec.joints if j.type in kinds and j.name not in following}
    every = [n for n in drivable if n in driven] or list(drivable)
    told = []
    for a in actuators:
        taken = {x.target for x in spec.actuators}
        names = [n for n in every if n not in taken] if a.joint == ANY_JOINT else [a.joint]
        for name in names:
            if name not in drivable or name in taken:
                why = "has two actuators" if name in taken else "is not there, or follows another"
                raise ValueError(f"{where}: --actuators: joint {name!r} {why}; joints to drive: {', '.join(drivable)}")
            add_actuator(spec, drivable[name], a)
            told.append(name)
    order = f"commands drive, in this order: {', '.join(told)}"
    settings = {", ".join([a.kind, *(f"{k} {v:g}" for k, v in a.settings.items())]) for a in actuators}
    passive = [n for n in drivable if n not in told] if len(every) < len(drivable) else []
    left = f"; the file names no drive of {', '.join(passive)}" if passive else ""
    return [f"actuators as declared ({'; '.join(sorted(settings))}); {order}{left}"]


def add_actuator(spec: mujoco.MjSpec, joint: Any, declared: DeclaredActuator) -> None:
    """One actuator on a joint; its name is the joint's."""
    made = spec.add_actuator()
    made.name = made.target = joint.name
    made.trntype = mujoco.mjtTrn.mjTRN_JOINT
    if declared.kind == "motor":
        made.set_to_motor()
        made.gear[0] = declared.settings["gear"]
        return
    gains = declared.settings
    if declared.kind == "position":
        made.set_to_position(kp=gains["kp"], kv=gains["kv"])
    else:
        made.set_to_velocity(kv=gains["kv"])

"""A robot's model from MJCF or URDF, ready for a diagnosis."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from idapt_pl.effects.compile_time import write_out_masses
from idapt_pl.prediction.model import name_elements, read_model
from idapt_pl.robot_files.actuators import DeclaredActuator, add_actuators
from idapt_pl.robot_files.urdf import joints_with_drives, prepare_urdf

LARGEST_FILE = 50_000_000
"""Bytes."""


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A model, and what its file said that is not in it.

    Attributes:
        spec: of the model; all its joints, bodies and actuators have names.
        notes: what was dropped, defaulted or declared, a sentence each.
    """

    spec: mujoco.MjSpec
    notes: tuple[str, ...]


def read_robot(path: Path, actuators: Sequence[DeclaredActuator] | None = None) -> RobotModel:
    """A model from MJCF or URDF (told by its first element), with actuators where the user declares them.

    Raises:
        ValueError: naming the file, and what is wrong with it.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected the model (MJCF or URDF)")
    notes: list[str] = []
    spec, driven = read_urdf(path, notes) if is_urdf(path) else (read_model(path), [])
    if actuators is not None:
        notes += add_actuators(spec, actuators, str(path), driven)
        try:
            spec = name_elements(spec)
        except ValueError as error:
            raise ValueError(f"{path}: with these actuators: {' '.join(str(error).split())}") from None
    return RobotModel(spec, tuple(notes))


def is_urdf(path: Path) -> bool:
    """Whether a file's first element is ``robot``."""
    try:
        _, element = next(ET.iterparse(path, events=("start",)))
    except (ET.ParseError, StopIteration, OSError, UnicodeDecodeError):
        return path.suffix.lower() == ".urdf"
    return str(element.tag).rpartition("}")[2] == "robot"


def read_urdf(path: Path, notes: list[str]) -> tuple[mujoco.MjSpec, list[str]]:
    """A URDF as the MJCF that MuJoCo makes of it, and the joints that it says are driven; ``notes`` get what is lost.

    Raises:
        ValueError: naming the file, and what is wrong with it.
    """
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"it is larger than {LARGEST_FILE // 10**6} MB")
        root = ET.parse(path).getroot()
        driven = joints_with_drives(root)
        notes += prepare_urdf(root, path.resolve().parent)
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        spec.compile()
        spec = name_elements(mujoco.MjSpec.from_string(spec.to_xml()))
        write_out_masses(spec)
    except (OSError, ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read as URDF: {' '.join(str(error).split())}") from None
    if not len(spec.joints):
        raise ValueError(f"{path}: no joint of it moves (all are fixed), so there is nothing to diagnose")
    return spec, driven

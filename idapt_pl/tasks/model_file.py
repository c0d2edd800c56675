"""Reading a robot's model for a task, MJCF or URDF."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco

from idapt_pl.robot_files.urdf import compiler_of, mend_urdf


def robot_spec(path: str | Path) -> mujoco.MjSpec:
    """A model to add a camera, motors and lights to.

    MJCF is read as it is. Of URDF, visual shapes and links without a joint are kept, which MuJoCo leaves out unless the
    file says otherwise: this project looks at robots, and names their links in effects. Meshes that cannot be read are
    left out, and masses and inertias that no body has are mended, with a warning.

    Args:
        path: of the file; meshes are looked for beside it, those of ``package://`` names also in the folders above.

    Raises:
        ValueError: if it cannot be read; the message names the file.
    """
    path = Path(path).resolve()
    try:
        root = ElementTree.parse(path).getroot()
        if root.tag != "robot":
            return mujoco.MjSpec.from_file(str(path))
        notes = mend_urdf(root, path.parent, looks=True)
        compiler = compiler_of(root)
        compiler.attrib = {"discardvisual": "false", "fusestatic": "false"} | compiler.attrib
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except (OSError, ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read as a model ({error})") from error
    if notes:
        warnings.warn(f"{path}: {'; '.join(notes)}", stacklevel=2)
    return spec

"""Reading a robot's model for a task, MJCF or URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco


def robot_spec(path: str | Path) -> mujoco.MjSpec:
    """A model to add a camera, motors and lights to.

    MJCF is read as it is. Of URDF, visual shapes and links without a joint are kept, which MuJoCo leaves out unless the
    file says otherwise: this project looks at robots, and names their links in effects.

    Args:
        path: of the file; meshes are looked for beside it.

    Raises:
        ValueError: if it cannot be read; the message names the file.
    """
    path = Path(path).resolve()
    try:
        root = ElementTree.parse(path).getroot()
        if root.tag != "robot":
            return mujoco.MjSpec.from_file(str(path))
        for mesh in root.iter("mesh"):
            mesh.set("filename", str(find_mesh(mesh.get("filename", ""), path.parent)))
        extension = root.find("mujoco")
        if extension is None:
            extension = ElementTree.SubElement(root, "mujoco")
        compiler = extension.find("compiler")
        if compiler is None:
            compiler = ElementTree.SubElement(extension, "compiler")
        compiler.attrib = {"discardvisual": "false", "fusestatic": "false"} | compiler.attrib | {"strippath": "false"}
        return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except (OSError, ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{path}: cannot be read as a model ({error})") from error


def find_mesh(name: str, folder: Path) -> Path:
    """Where a mesh of a URDF is.

    ``package://PACKAGE/FILE`` is looked for as PACKAGE/FILE and FILE in the URDF's folder and in those above it.

    Raises:
        FileNotFoundError: if it is nowhere.
    """
    if not name.startswith("package://"):
        return folder / name.removeprefix("file://")
    whole = Path(name.removeprefix("package://"))
    tried = [above / part for above in (folder, *folder.parents) for part in (whole, Path(*whole.parts[1:]))]
    found = next((file for file in tried if file.is_file()), None)
    if found is None:
        raise FileNotFoundError(f"mesh {name} is neither in {folder} nor in a folder above it")
    return found

"""A URDF made readable for MuJoCo, as far as possible, with a sentence for everything that is dropped or defaulted."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

MESHES = (".stl", ".obj", ".msh")
"""Kinds of mesh files that MuJoCo reads."""

LEAST_MASS, LEAST_INERTIA = 1e-4, 1e-7
"""What a moving link without mass or inertia gets [kg, kg·m²]."""

WATER = 1000
"""Density by which MuJoCo makes masses of shapes [kg/m³]."""

DROPPED = {
    "transmission": "gears of transmissions are not read: commands act on the joints",
    "gazebo": "<gazebo> elements are not read (friction of contacts, sensors, plugins)",
}
MOST_LISTED = 6
"""Names that a sentence lists."""


def name_list(names: Iterable[str]) -> str:
    """Names in a sentence."""
    every = list(dict.fromkeys(names))
    more = f" and {len(every) - MOST_LISTED} more" if len(every) > MOST_LISTED else ""
    return ", ".join(every[:MOST_LISTED]) + more


def mend_urdf(root: ET.Element, folder: Path, looks: bool = False) -> list[str]:
    """Edit a URDF so that MuJoCo reads it; what had to be left out or guessed, in sentences.

    Args:
        root: its ``robot`` element, edited in place.
        folder: where meshes are looked for; ``package://`` also in the folders above.
        looks: keep what is only seen.

    Raises:
        ValueError: it is xacro, which has to be expanded first, or a joint names a link that is not there.
    """
    if any("xacro" in e.tag or "xacro" in " ".join(e.attrib) for e in root.iter() if isinstance(e.tag, str)):
        raise ValueError("this is xacro, not URDF: expand it first, as in `xacro robot.urdf.xacro > robot.urdf`")
    name_the_world(root)
    check_links(root)
    compiler_of(root).set("strippath", "false")
    seen = drop_unreadable(root, folder, "visual", "it is not seen") if looks else drop_looks(root, folder)
    touching = drop_unreadable(root, folder, "collision", "it touches nothing with it")
    return [*seen, *touching, *mend_inertials(root)]


def prepare_urdf(root: ET.Element, folder: Path) -> list[str]:
    """Edit a URDF for a diagnosis, which looks at no shape that is only seen; what is lost of it, in sentences.

    Args:
        root: its ``robot`` element, edited in place.
        folder: where meshes are looked for.

    Raises:
        ValueError: as ``mend_urdf`` does.
    """
    notes = [*mend_urdf(root, folder), *joints_lost(root)]
    for tag, words in DROPPED.items():
        if found := root.findall(tag):
            named_joints = [j.get("name", "") for t in found for j in t.iter("joint")]
            notes.append(f"{words}{f' ({name_list(named_joints)})' if any(named_joints) else ''}")
            for element in found:
                root.remove(element)
    compiler_of(root).set("fusestatic", "true")
    return notes


def joints_with_drives(root: ET.Element) -> list[str]:
    """Joints that a URDF says are driven, by its transmissions or commands of ros2_control, in its order."""
    joints = [j for t in root.findall("transmission") for j in t.iter("joint")]
    joints += [
        j for c in root.findall("ros2_control") for j in c.iter("joint") if j.find("command_interface") is not None
    ]
    return list(dict.fromkeys(j.get("name", "") for j in joints))


def compiler_of(root: ET.Element) -> ET.Element:
    """The settings of MuJoCo's compiler in a URDF, made where there are none."""
    element = root
    for tag in ("mujoco", "compiler"):
        found = element.find(tag)
        element = ET.SubElement(element, tag) if found is None else found
    return element


def name_the_world(root: ET.Element) -> None:
    """Put in the link ``world`` where joints hang on it and it is not there: Drake knows it without being told."""
    parents = {p.get("link") for j in root.findall("joint") if (p := j.find("parent")) is not None}
    if "world" in parents - {link.get("name") for link in root.findall("link")}:
        ET.SubElement(root, "link", name="world")


def check_links(root: ET.Element) -> None:
    """See that joints name links that are there.

    Raises:
        ValueError: naming the joint and the link.
    """
    links = {link.get("name") for link in root.findall("link")}
    for joint in root.findall("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            name = None if element is None else element.get("link")
            if name not in links:
                raise ValueError(f"joint {joint.get('name')!r}: its {end} link {name!r} is not there")


# --- shapes ---------------------------------------------------------------------------------------------


def drop_looks(root: ET.Element, folder: Path) -> list[str]:
    """Leave out what is only seen; a sentence of meshes that are not there anyway."""
    unseen = []
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            unseen += [m.get("filename", "") for m in visual.iter("mesh") if find_robot_mesh(m, folder) is None]
            link.remove(visual)
    if not unseen:
        return []
    return [f"{len(set(unseen))} visual meshes are not there ({name_list(unseen)}): a diagnosis does not need them"]


def drop_unreadable(root: ET.Element, folder: Path, kind: str, consequence: str) -> list[str]:
    """Leave out shapes of a kind (``visual`` or ``collision``) whose mesh cannot be read; a sentence for each."""
    notes = []
    for link in root.findall("link"):
        for shape in link.findall(kind):
            if problem := mesh_problem(shape, folder):
                notes.append(f"link {link.get('name')}: its {kind} {problem}: {consequence}")
                link.remove(shape)
    return list(dict.fromkeys(notes))


def mesh_problem(shape: ET.Element, folder: Path) -> str | None:
    """Why a shape's mesh cannot be read, None where it can; its path is written where it was found."""
    for mesh in shape.iter("mesh"):
        path, name = find_robot_mesh(mesh, folder), mesh.get("filename", "")
        if path is None:
            return f"mesh {name} is not there"
        if path.suffix.lower() not in MESHES:
            return f"mesh {name} is no {', '.join(MESHES)}"
        mesh.set("filename", str(path))
    return None


def find_robot_mesh(mesh: ET.Element, folder: Path) -> Path | None:
    """Where a mesh is; None if it is nowhere.

    ``package://PACKAGE/FILE`` is looked for as PACKAGE/FILE and as FILE, in the URDF's folder and in those above it.
    """
    name = mesh.get("filename", "").removeprefix("file://")
    if not name.startswith(("package://", "model://")):
        path = folder / name
        return path if name and path.is_file() else None
    whole = Path(name.split("://", 1)[1])
    tried = [above / part for above in (folder, *folder.parents) for part in (whole, Path(*whole.parts[1:]))]
    return next((file for file in tried if file.is_file()), None)


# --- inertias -------------------------------------------------------------------------------------------


def mend_inertials(root: ET.Element) -> list[str]:
    """Give masses and inertias that MuJoCo takes; a sentence for each kind of what is missing."""
    moving = moving_links(root)
    shaped, bare, zero, odd = (list[str]() for _ in range(4))
    for link in root.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        mass, inertia = mass_and_inertia(inertial)
        if mass <= 0 and inertial is not None:
            link.remove(inertial)
        if mass <= 0:
            if name in moving:
                (shaped if link.find("collision") is not None else bare).append(name)
            continue
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] <= 0 and np.abs(inertia).max() < LEAST_INERTIA:
            zero.append(name)
        elif moments[0] <= 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-6):
            odd.append(name)
        if inertial is not None and moments[0] <= 0:  # before it looks at bounds, MuJoCo refuses these
            set_round_inertia(inertial, max(float(np.abs(moments).mean()), LEAST_INERTIA))
    compiler, notes = compiler_of(root), []
    if shaped:
        notes.append(
            f"no mass given for {name_list(shaped)}: it is that of their collision shapes at {WATER} kg/m³, a guess"
        )
    if bare:
        compiler.attrib |= {"boundmass": f"{LEAST_MASS}", "boundinertia": f"{LEAST_INERTIA}"}
        notes.append(f"no mass and no shape for {name_list(bare)}: {LEAST_MASS} kg, next to nothing")
    if zero:
        compiler.attrib |= {"boundinertia": f"{LEAST_INERTIA}"}
        notes.append(f"no inertia given for {name_list(zero)}: {LEAST_INERTIA} kg·m², next to nothing")
    if odd:
        compiler.attrib |= {"balanceinertia": "true"}
        notes.append(f"inertia of {name_list(odd)} is that of no body (A + B < C): the mean of the three is taken")
    return notes


def set_round_inertia(inertial: ET.Element, value: float) -> None:
    """Give a link the same moment of inertia [kg·m²] about all axes."""
    for element in inertial.findall("inertia"):
        inertial.remove(element)
    off = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
    ET.SubElement(inertial, "inertia", off | dict.fromkeys(("ixx", "iyy", "izz"), f"{value:.9g}"))


def mass_and_inertia(inertial: ET.Element | None) -> tuple[float, np.ndarray]:
    """Mass [kg] and inertia [kg·m²], (3, 3); zeros where they are not given.

    Raises:
        ValueError: one of them is no number.
    """
    mass, matrix = 0.0, np.zeros((3, 3))
    if inertial is None:
        return mass, matrix
    if (element := inertial.find("mass")) is not None:
        mass = number_of(element, "value")
    if (element := inertial.find("inertia")) is not None:
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"):
                matrix[i, j] = number_of(element, f"i{min(a, b)}{max(a, b)}")
    return mass, matrix


def number_of(element: ET.Element, attribute: str) -> float:
    """A number in an attribute; 0 where it is not given.

    Raises:
        ValueError: naming the element and the attribute.
    """
    text = element.get(attribute, "0")
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"<{element.tag} {attribute}={text!r}>: expected a number")
    return value


def moving_links(root: ET.Element) -> set[str]:
    """Links whose own joint moves."""
    moving = set()
    for joint in root.findall("joint"):
        child = joint.find("child")
        if child is not None and joint.get("type") != "fixed":
            moving.add(child.get("link", ""))
    return moving


# --- joints ---------------------------------------------------------------------------------------------


def joints_lost(root: ET.Element) -> list[str]:
    """What MuJoCo drops of joints or takes to be nothing, in sentences."""
    joints = [j for j in root.findall("joint") if j.get("type") in ("revolute", "continuous", "prismatic")]
    notes = [words for words in joint_notes(joints) if words]
    children = {c.get("link") for j in root.findall("joint") if (c := j.find("child")) is not None}
    bases = [link.get("name", "") for link in root.findall("link") if link.get("name") not in children]
    if bases and bases != ["world"]:
        notes.append(f"the base ({name_list(bases)}) is fixed to the world: URDF has no words for one that moves")
    return notes


def joint_notes(joints: list[ET.Element]) -> Iterator[str]:
    """The same, of joints that move."""

    def those(tag: str, attribute: str | None = None, absent: bool = False) -> list[str]:
        """Names of joints that have an element (with an attribute other than 0), or have none."""
        found = []
        for j in joints:
            element = j.find(tag)
            has = element is not None and (attribute is None or number_of(element, attribute) != 0)
            if has != absent:
                found.append(j.get("name", ""))
        return found

    if names := those("dynamics", "damping", absent=True):
        yield f"no damping given for {name_list(names)}: 0"
    if names := those("dynamics", "friction", absent=True):
        yield f"no friction given for {name_list(names)}: 0"
    if names := [j.get("name", "") for j in joints if j.get("type") != "continuous" and no_range(j)]:
        yield f"no position limits given for {name_list(names)}: none"
    if names := those("limit", "effort", absent=True):
        yield f"no effort limits given for {name_list(names)}: none"
    if names := those("limit", "velocity"):
        yield f"velocity limits are dropped, as MuJoCo has none ({name_list(names)})"
    if names := those("mimic"):
        yield f"mimic joints follow by a soft constraint, not exactly ({name_list(names)})"
    for tag in ("safety_controller", "calibration"):
        if names := those(tag):
            yield f"<{tag}> is not read ({name_list(names)})"


def no_range(joint: ET.Element) -> bool:
    """Whether a joint has no position limits."""
    limit = joint.find("limit")
    return limit is None or not number_of(limit, "lower") < number_of(limit, "upper")

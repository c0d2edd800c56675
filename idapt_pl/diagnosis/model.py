"""The nominal model, read from a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco


def read_model(path: Path) -> mujoco.MjSpec:
    """A model as something that effects can edit; joints, bodies and actuators without a name get one.

    Names are those of ``idapt import``: ``joint0``, ``body1``, ``actuator0``.

    Raises:
        ValueError: naming the file and what MuJoCo says of it.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected the model (MJCF)")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        twin = spec.copy()  # elements have numbers only once compiled
        model = twin.compile()
        for kind, of in (("joint", "joints"), ("body", "bodies"), ("actuator", "actuators")):
            name_all(kind, getattr(spec, of), [e.id for e in getattr(twin, of)])
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read the model: {' '.join(str(error).split())}") from None
    if not model.nv:
        raise ValueError(f"{path}: the model has no joints, so nothing in it can move")
    return spec


def name_all(kind: str, elements: Sequence[Any], numbers: Sequence[int]) -> None:
    """Give the nameless elements of a kind a name by their number."""
    taken = {e.name for e in elements}
    for e, number in zip(elements, numbers, strict=True):
        if not e.name:
            name = f"{kind}{number}"
            while name in taken:
                name += "_"
            e.name = name
            taken.add(name)

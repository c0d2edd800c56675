"""The nominal model, read from a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco

from idapt_pl.effects.compile_time import write_out_masses


def read_model(path: Path) -> mujoco.MjSpec:
    """A model as something that effects can edit; what has no name gets one (:func:`name_elements`).

    Where ``fusestatic`` makes bodies one with what they are welded to, they are one from the start: effects act on what
    is simulated.

    Raises:
        ValueError: naming the file and what MuJoCo says of it.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected the model (MJCF)")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if spec.compiler.fusestatic:
            spec.compile()  # after which the spec has the fused bodies, as compiled
            spec.compiler.fusestatic = False
        write_out_masses(name_elements(spec))
    except ValueError as error:
        raise ValueError(f"{path}: MuJoCo cannot read the model: {' '.join(str(error).split())}") from None
    if not len(spec.joints):
        raise ValueError(f"{path}: the model has no joints, so nothing in it can move")
    return spec


def name_elements(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Give joints, bodies and actuators without a name one: ``joint0``, ``body1``, ``actuator0``, by their number.

    An actuator that is alone on its joint is called like the joint instead. Returns ``spec``, which is edited.
    """
    twin = spec.copy()  # elements have numbers only once compiled
    twin.compile()
    for kind, of in (("joint", "joints"), ("body", "bodies")):
        numbers = [e.id for e in getattr(twin, of)]
        name_all(getattr(spec, of), [f"{kind}{n}" for n in numbers])
    driven = [a.target if a.trntype == mujoco.mjtTrn.mjTRN_JOINT else "" for a in spec.actuators]
    alone = [bool(d) and driven.count(d) == 1 for d in driven]
    names = [d if ok else f"actuator{a.id}" for d, ok, a in zip(driven, alone, twin.actuators, strict=True)]
    name_all(spec.actuators, names)
    return spec


def without_textures(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """A model without textures and skins, which say nothing of motion and take long to compile. ``spec`` is edited."""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for kind in (spec.textures, spec.skins):
        for element in list(kind):
            spec.delete(element)
    return spec


def name_all(elements: Sequence[Any], names: Sequence[str]) -> None:
    """Give the nameless among some elements these names, longer ones where they are taken."""
    taken = {e.name for e in elements}
    for e, name in zip(elements, names, strict=True):
        if not e.name:
            while name in taken:
                name += "_"
            e.name = name
            taken.add(name)

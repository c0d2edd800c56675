"""What differs between two compiled models, read from the models themselves."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from idapt_pl.effects.visual import engine_of

KINDS: dict[str, tuple[str, str]] = {
    "body": ("nbody", "mjOBJ_BODY"),
    "jnt": ("njnt", "mjOBJ_JOINT"),
    "dof": ("nv", "mjOBJ_DOF"),
    "geom": ("ngeom", "mjOBJ_GEOM"),
    "site": ("nsite", "mjOBJ_SITE"),
    "cam": ("ncam", "mjOBJ_CAMERA"),
    "light": ("nlight", "mjOBJ_LIGHT"),
    "mat": ("nmat", "mjOBJ_MATERIAL"),
    "tex": ("ntex", "mjOBJ_TEXTURE"),
    "actuator": ("nu", "mjOBJ_ACTUATOR"),
    "eq": ("neq", "mjOBJ_EQUALITY"),
}
"""Prefix of a model's arrays to how many elements of that kind there are, and their type."""

VISUAL = ("geom_rgba", "geom_matid", "geom_shown", "cam_", "light_", "mat_", "tex_", "headlight", "renderer")
"""Beginnings of the names of fields that change images alone."""

FOLLOWS = re.compile(
    "body_subtreemass|(body|dof)_invweight0|dof_M0|actuator_acc0|cam_(pos0|mat0|poscom0)|light_(pos0|poscom0|dir0)"
    "|.*_(adr|id|num|user|bodyid|parentid|rootid|weldid|dofadr|geomadr|geomnum|childadr|treeid|plugin|sameframe)"
    "|body_bvh.*|geom_dataid|mat_texid|tex_(adr|pathadr|data|nchannel)|(cam|light)_target.*id"
)
"""Fields that follow from others, or say where something is stored."""


@dataclass(frozen=True)
class Difference:
    """One field of one element.

    Attributes:
        field: name of the model's array, such as ``body_mass``.
        element: name of the body, joint, geom, ...; ``"world"`` for the model's own options.
        before: value in the first model, None if it has no such element.
        after: value in the second.
    """

    field: str
    element: str
    before: Any
    after: Any

    @property
    def visual(self) -> bool:
        """Whether it changes images alone."""
        return self.field.startswith(VISUAL) or self.field in ("light", "mat", "tex", "cam")


def differences(a: mujoco.MjModel, b: mujoco.MjModel) -> list[Difference]:
    """Every difference between two models, in the order of :data:`KINDS`; elements are matched by their names."""
    found = _of_options(a, b)
    for prefix in KINDS:
        names_a, names_b = _names(a, prefix), _names(b, prefix)
        found += [Difference(_kind(a, prefix, i), n, n, None) for n, i in names_a.items() if n not in names_b]
        found += [Difference(_kind(b, prefix, i), n, None, n) for n, i in names_b.items() if n not in names_a]
        for field in _fields(a, prefix):
            for name in (n for n in names_a if n in names_b):
                before, after = (_value(m, field, names[name]) for m, names in ((a, names_a), (b, names_b)))
                if not np.array_equal(before, after):
                    found.append(Difference(field, name, before, after))
    return found


def _kind(model: mujoco.MjModel, prefix: str, i: int) -> str:
    """What an element that only one model has is called: ``geom_shown`` for a geom that touches nothing."""
    only_seen = prefix == "geom" and not (model.geom_contype[i] or model.geom_conaffinity[i])
    return "geom_shown" if only_seen else prefix


def _names(model: mujoco.MjModel, prefix: str) -> dict[str, int]:
    """Names to indices; what has no name is called by its number, a geom by its number in its body."""
    count, kind = KINDS[prefix]
    names: dict[str, int] = {}
    for i in range(getattr(model, count)):
        if prefix == "dof":
            joint = int(model.dof_jntid[i])
            name, first = model.joint(joint).name, int(model.jnt_dofadr[joint])
            name = name if i == first and model.jnt_type[joint] >= 2 else f"{name or joint}[{i - first}]"
        else:
            name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, kind), i)
        if not name and prefix == "geom":
            body = model.geom_bodyid[i]
            name = f"{model.body(body).name}[{i - model.body_geomadr[body]}]"
        names[name or f"#{i}"] = i
    return names


def _fields(model: mujoco.MjModel, prefix: str) -> list[str]:
    count = getattr(model, KINDS[prefix][0])
    arrays = [k for k in dir(model) if k.startswith(f"{prefix}_") and not FOLLOWS.fullmatch(k)]
    arrays = [k for k in arrays if isinstance(getattr(model, k), np.ndarray) and len(getattr(model, k)) == count]
    return arrays + (["tex_mean_color"] if prefix == "tex" else [])


def _value(model: mujoco.MjModel, field: str, i: int) -> Any:
    if field == "tex_mean_color":
        size = int(model.tex_height[i] * model.tex_width[i] * model.tex_nchannel[i])
        pixels = model.tex_data[model.tex_adr[i] : model.tex_adr[i] + size]
        return pixels.reshape(-1, int(model.tex_nchannel[i])).mean(0).round(1)
    value = getattr(model, field)[i]
    if field in ("geom_matid", "site_matid"):
        return model.material(value).name if value >= 0 else "none"
    return value.copy() if isinstance(value, np.ndarray) else value


def _of_options(a: mujoco.MjModel, b: mujoco.MjModel) -> list[Difference]:
    found = []
    for owner, prefix in (("opt", "opt"), ("vis.headlight", "headlight")):
        x, y = (_resolve(m, owner) for m in (a, b))
        for key in (k for k in dir(x) if not k.startswith("_")):
            before, after = getattr(x, key), getattr(y, key)
            if not callable(before) and not np.array_equal(before, after):
                found.append(Difference(f"{prefix}.{key}", "world", np.copy(before), np.copy(after)))
    engines = [engine_of(m) for m in (a, b)]
    return found + ([Difference("renderer", "world", *engines)] if engines[0] != engines[1] else [])


def _resolve(model: mujoco.MjModel, path: str) -> Any:
    for part in path.split("."):
        model = getattr(model, part)
    return model

"""Lists of effects, as ``effects.yaml`` has them: written by ``idapt diagnose`` and by runs, read by both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from idapt_pl.effects.base import Effect, effect_from_dict
from idapt_pl.files import read_yaml


def read_effects(path: Path, model: mujoco.MjSpec) -> tuple[Effect, ...]:
    """The effects in a YAML list, each tried on the model.

    Raises:
        ValueError: naming the file, the entry and what is known.
    """
    return effects_from_list(read_effect_list(path), model, str(path))


def read_effect_list(path: Path) -> list[Any]:
    """The entries of a YAML list of effects, as they stand there.

    Raises:
        ValueError: if there is no such file, or it holds no list.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected a list of effects (YAML)")
    entries = read_yaml(path)
    if not isinstance(entries, list):
        raise ValueError(f"{path}: expected a list of effects, got {type(entries).__name__}; see idapt diagnose --help")
    return entries


def effects_from_list(entries: list[Any], model: mujoco.MjSpec, where: str) -> tuple[Effect, ...]:
    """Effects, each tried on the model.

    Args:
        entries: one for each, as a mapping.
        model: stays as it is.
        where: names the list in errors.

    Raises:
        ValueError: naming the list, the entry and what is known.
    """
    spec, effects = model.copy(), []
    for i, entry in enumerate(entries):
        try:
            effects.append(read_effect(entry))
            effects[-1].apply(spec)
            spec.copy().compile()
        except ValueError as error:
            raise ValueError(f"{where}: entry {i}: {' '.join(str(error).split())}") from None
    return tuple(effects)


def read_effect(entry: Any) -> Effect:
    """One entry of a list of effects."""
    if isinstance(entry, Mapping):
        if not isinstance(entry.get("effect", ""), str):
            raise ValueError(f"effect must be a name, got {entry['effect']!r}")
        if not isinstance(entry.get("target", ""), str):
            raise ValueError(f"effect {entry['effect']!r}: target must be a name, got {entry['target']!r}")
        if not isinstance(entry.get("parameters", {}), Mapping):
            raise ValueError(f"parameters must be names with values, got {entry['parameters']!r}")
    return effect_from_dict(entry)

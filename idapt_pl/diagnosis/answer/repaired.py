"""The nominal model with effects, as plain MJCF that loads from where it is written."""

from __future__ import annotations

import difflib
import os
from dataclasses import dataclass
from pathlib import Path

import mujoco

from idapt_pl.diagnosis.candidates.held_joints import release
from idapt_pl.effects.base import Effect
from idapt_pl.prediction.simulator import Effects


@dataclass(frozen=True)
class RepairedModel:
    """A model before and after.

    Attributes:
        nominal: MJCF.
        patched: MJCF with the effects.
        unsaid: effects that MJCF has no words for.
    """

    nominal: str
    patched: str
    unsaid: tuple[Effect, ...]

    def difference(self) -> list[str]:
        """Lines of a unified diff."""
        return list(
            difflib.unified_diff(
                self.nominal.splitlines(), self.patched.splitlines(), "nominal.xml", "patched.xml", lineterm="", n=2
            )
        )


def repair_model(nominal: mujoco.MjSpec, effects: Effects, folder: Path) -> RepairedModel:
    """Write effects into a model that will lie in ``folder``."""
    spec, unsaid = release(nominal.copy()), []
    before = last = model_as_mjcf(spec, folder)
    for effect in effects:
        effect.apply(spec)
        now = model_as_mjcf(spec, folder)
        if now == last:
            unsaid.append(effect)
        last = now
    return RepairedModel(before, last, tuple(unsaid))


def model_as_mjcf(spec: mujoco.MjSpec, folder: Path) -> str:
    """The MJCF of a model that will lie in ``folder``."""
    twin = spec.copy()
    move_assets(twin, folder)
    twin.compile()
    return twin.to_xml()


def move_assets(spec: mujoco.MjSpec, folder: Path) -> None:
    """Let a model lie in another folder: meshes and textures are then found from there."""
    if not spec.modelfiledir:
        return
    home = Path(spec.modelfiledir)
    if any(a.file for a in (*spec.meshes, *spec.hfields, *spec.skins)) and not os.path.isabs(spec.meshdir):
        spec.meshdir = os.path.relpath(home / spec.meshdir, folder)
    if any(t.file or any(t.cubefiles) for t in spec.textures) and not os.path.isabs(spec.texturedir):
        spec.texturedir = os.path.relpath(home / spec.texturedir, folder)
    spec.modelfiledir = str(folder)

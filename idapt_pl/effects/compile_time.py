"""What MuJoCo does to masses while it compiles, done beforehand: else it would undo what effects change."""

from __future__ import annotations

import mujoco
import numpy as np

from idapt_pl.effects.bodies import compiled_bodies

OFF = {"settotalmass": -1.0, "boundmass": 0.0, "boundinertia": 0.0, "balanceinertia": False}
"""Settings of the compiler that change masses and inertias, and what they are where they change none."""

FROM_GEOMS = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
"""Whatever is given for bodies is overruled by their geoms."""


def write_out_masses(spec: mujoco.MjSpec) -> None:
    """Give bodies the masses and inertias that they are compiled with, where the compiler would change them.

    ``settotalmass`` would scale all others down where an effect makes a body heavier, and ``boundmass`` or
    ``inertiafromgeom`` overrule it. What is compiled stays the same; the spec is edited.
    """
    compiler = spec.compiler
    changing = [name for name, off in OFF.items() if getattr(compiler, name) > off]
    overruled = compiler.inertiafromgeom == FROM_GEOMS and any(body.explicitinertial for body in spec.bodies)
    if changing or overruled:
        model = compiled_bodies(spec)
        for i, body in enumerate(spec.bodies):
            if i > 0 and model.body_mass[i] > 0:
                body.explicitinertial, body.mass = True, float(model.body_mass[i])
                body.ipos, body.iquat, body.inertia = model.body_ipos[i], model.body_iquat[i], model.body_inertia[i]
                body.fullinertia = [np.nan, 0, 0, 0, 0, 0]  # not given
    for name in changing:
        setattr(compiler, name, OFF[name])
    if compiler.inertiafromgeom == FROM_GEOMS:
        compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO

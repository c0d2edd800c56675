"""A compiled model with room to simulate it, for several threads, and without what takes time and moves nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import mujoco
import numpy as np

Off, On = mujoco.mjtDisableBit, mujoco.mjtEnableBit


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """A model, and room to simulate it that nobody uses now.

    Attributes:
        model: that is simulated.
        spare: such room.
    """

    model: mujoco.MjModel
    spare: list[mujoco.MjData] = field(default_factory=list)

    @contextmanager
    def room(self, rooms: int) -> Iterator[list[mujoco.MjData]]:
        """Room for so many simulations at once; nobody else has it meanwhile."""
        taken: list[mujoco.MjData] = []
        while len(taken) < rooms:
            try:
                taken.append(self.spare.pop())
            except IndexError:
                taken.append(mujoco.MjData(self.model))
        try:
            yield taken
        finally:
            self.spare.extend(taken)


def for_motion_alone(model: mujoco.MjModel) -> mujoco.MjModel:
    """Switch off what takes time in every step and moves nothing; ``model`` is edited.

    That is sensors, contacts where no two geoms can touch, and constraint islands, of which one machine has one.
    """
    model.opt.disableflags |= Off.mjDSBL_SENSOR
    if not model.opt.enableflags & On.mjENBL_SLEEP:  # islands are what sleeps
        model.opt.disableflags |= Off.mjDSBL_ISLAND
    if not can_touch(model):
        model.opt.disableflags |= Off.mjDSBL_CONTACT
    return model


def can_touch(model: mujoco.MjModel) -> bool:
    """Whether MuJoCo would look for a contact between any two geoms, wherever they are."""
    if model.npair or model.nflex:
        return True
    a, b = np.triu_indices(model.ngeom, 1)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    meet = (kind[a] & affinity[b]) | (kind[b] & affinity[a]) != 0
    one, other = (model.body_weldid[model.geom_bodyid[g[meet]]] for g in (a, b))
    parent = model.body_weldid[model.body_parentid]
    alike = one == other
    if not model.opt.disableflags & Off.mjDSBL_FILTERPARENT:  # a link and what carries it, unless that is the world
        alike |= (one != 0) & (other != 0) & ((parent[one] == other) | (parent[other] == one))
    return not alike.all()

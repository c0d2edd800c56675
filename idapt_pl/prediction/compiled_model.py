"""A compiled model with room to simulate it, for several threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import mujoco


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

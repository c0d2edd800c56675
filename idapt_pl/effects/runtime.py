"""Effects on the way from a command to a force and from a motion to a measurement.

Where MJCF has words for one, ``apply`` writes them. A simulation that replays recorded commands uses
``transform``, ``force`` and ``measure`` instead: delays then need not be whole time steps.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect, find_elements


@dataclass(frozen=True)
class Command:
    """Piecewise-constant commands: ``values[k]`` (nu,) holds from ``edges[k]`` to ``edges[k + 1]`` [s]."""

    edges: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class RuntimeEffect(Effect):
    """An effect that a simulation can apply itself, outside the model: on commands, forces or measurements."""

    @property
    def constrains(self) -> bool:
        """Whether the simulation needs something in the model beside that."""
        return False

    def constrain(self, spec: mujoco.MjSpec) -> None:
        """Write that into the model."""


@dataclass(frozen=True)
class CommandEffect(RuntimeEffect):
    """Something that happens to a command before it becomes a force; target: an actuator, or ``"*"``.

    Attributes:
        in_mjcf: whether ``apply`` writes it into the model; if not, environments put commands through ``law``.
    """

    in_mjcf: ClassVar[bool] = True

    def columns(self, model: mujoco.MjModel) -> list[int]:
        """The commands that ``law`` takes and gives, as columns of ``data.ctrl``."""
        return [i for i in range(model.nu) if self.target in ("*", model.actuator(i).name)]

    def transform(self, command: Command, columns: list[int], step: float) -> Command:
        """What arrives of a command. ``columns`` are the actuators meant, ``step`` the simulation's time step [s]."""
        values = command.values.copy()
        values[:, columns] = self.law(values[:, columns])
        return Command(command.edges, values)

    def law(self, values: np.ndarray) -> np.ndarray:
        """For effects without memory: command to command."""
        raise NotImplementedError

    def apply(self, spec: mujoco.MjSpec) -> None:
        find_elements(spec, "actuators", self.target)  # no MJCF for it; the target must exist all the same


def replace_columns(command: Command, columns: list[int], edges: np.ndarray, values: np.ndarray) -> Command:
    """A command some of whose columns have other edges: both sets of edges are kept."""
    union = np.union1d(command.edges, edges)
    union = union[union < max(command.edges[-1], edges[-1])]
    at = np.clip(np.searchsorted(command.edges, union, side="right") - 1, 0, len(command.values) - 1)
    merged = command.values[at]
    at = np.clip(np.searchsorted(edges, union, side="right") - 1, 0, len(values) - 1)
    merged[:, columns] = values[at]
    return Command(np.append(union, union[-1] + 10.0), merged)


def mean_between(command: Command, at: np.ndarray) -> np.ndarray:
    """Means of a command between times: (rows, steps + 1) to (rows, steps, columns)."""
    # the integral of a piecewise-constant command is piecewise linear: its slope over a step is the mean
    early, late = command.edges[0] - 100.0, command.edges[-1] + 100.0
    edges = np.concatenate([[early], command.edges[: len(command.values)], [late]])
    values = np.concatenate([command.values[:1], command.values])
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values * np.diff(edges)[:, None], 0)])
    means = [np.diff(np.interp(at, edges, column), axis=1) for column in total.T]
    return np.stack(means, -1) / np.diff(at, axis=1)[..., None]


def delay_columns(command: Command, columns: list[int], by: float) -> Command:
    """A command some of whose columns arrive later by some seconds."""
    return replace_columns(command, columns, command.edges + by, command.values[:, columns])


@dataclass(frozen=True)
class ForceEffect(RuntimeEffect):
    """A force law that MJCF has no words for; target: a joint, a body, or ``"*"``.

    Attributes:
        acts_on: what the target is, ``"joints"`` or ``"bodies"``.
    """

    acts_on: ClassVar[str] = "joints"

    def apply(self, spec: mujoco.MjSpec) -> None:
        find_elements(spec, self.acts_on, self.target)

    @abstractmethod
    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Torques on the joints meant, (n, joints), from their positions and velocities; or a body's force, (n, 3)."""


@dataclass(frozen=True)
class SensingEffect(RuntimeEffect):
    """Something between a joint's motion and its measurement; target: a joint, or ``"*"``."""

    def apply(self, spec: mujoco.MjSpec) -> None:
        find_elements(spec, "joints", self.target)

    @abstractmethod
    def measure(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is measured of positions and velocities."""

    @abstractmethod
    def invert(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities from what was measured."""

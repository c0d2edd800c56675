"""A candidate: an effect with free parameters, where a search starts and in which steps it goes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from idapt_pl.effects.base import Effect


@dataclass(frozen=True)
class Candidate:
    """One effect with its free parameters; a vector x of them makes an :class:`Effect`.

    Attributes:
        kind: the effect's class.
        target: MJCF name.
        names: free parameters.
        nominal: their values in the nominal model, where the effect changes nothing.
        scale: what a noticeable change of each is about; fits work in units of it.
        starts: further places to start a fit from, each (parameters,).
        fixed: parameters that are not free.
        span: narrower bounds, a pair for each parameter, where more would not be this effect any more.
        strength: how many of the parameters, from the first on, say how strong it is; the others say where or how.
    """

    kind: type[Effect]
    target: str
    names: tuple[str, ...]
    nominal: tuple[float, ...]
    scale: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...] = ()
    fixed: tuple[tuple[str, object], ...] = ()
    span: tuple[tuple[float, float], ...] | None = None
    strength: int | None = None

    @property
    def label(self) -> str:
        """``effect(target)``."""
        return f"{self.kind.name}({self.target})"

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.names)

    def change(self, x: np.ndarray) -> float:
        """How much an effect with these values changes, in units of a noticeable change."""
        n = self.strength or self.size
        return float(np.max(np.abs(np.subtract(x, self.nominal)[:n]) / np.array(self.scale[:n])))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the parameters."""
        if self.span is not None:
            return tuple(np.array(self.span, float).T)
        meta = {f.name: f.metadata for f in dataclasses.fields(self.kind)}
        low, high = (np.array([meta[n][side] for n in self.names], float) for side in ("low", "high"))
        return low, high

    def units(self) -> list[str]:
        """Units of the parameters."""
        meta = {f.name: f.metadata for f in dataclasses.fields(self.kind)}
        return [meta[n]["unit"] for n in self.names]

    def effect(self, x: Iterable[float]) -> Effect:
        """The effect with these values, moved inside the bounds."""
        low, high = self.bounds()
        values = np.clip(np.asarray(list(x), float), low, high)
        return self.kind(self.target, **dict(zip(self.names, map(float, values), strict=True)), **dict(self.fixed))


@dataclass(frozen=True)
class TypicalSizes:
    """Typical sizes in the data, which set the scales of the candidates.

    Attributes:
        dt: control period, s.
        inertia: diagonal of the mass matrix, typical, (nv,).
        speed: rms of the velocities, (nv,).
        motion: spread of the positions of each scalar joint, (nv,).
        range: from their least to their greatest, (nv,).
        command: rms of the commands, (nu,).
        force: rms of the actuators' forces in the nominal model, (nu,).
        horizon: how long predictions run, s.
    """

    dt: float
    inertia: np.ndarray
    speed: np.ndarray
    motion: np.ndarray
    range: np.ndarray
    command: np.ndarray
    force: np.ndarray
    horizon: float

"""How many periods in a turn a torque has that repeats with a joint's angle: where fits of a cogging torque start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np

from idapt_pl.effects.base import Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.runtime import ForceEffect
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.simulator import Simulator

MOST_PULSES = 8
"""Stretches that a window is cut into, at most."""

FINENESS = 0.5
"""Step of the periods that are tried: over the whole range of the joint the phase changes by so much, rad."""

PEAKS = 3
"""Numbers of periods that fits start from."""


@dataclass(frozen=True, eq=False)
class TorquePulse(ForceEffect):
    """A constant torque on a joint from one time to another, which differ from window to window.

    No effect of a model: it measures how predictions answer torques.

    Attributes:
        torque: N·m.
        begin: s, of each window, (n,).
        end: s, of each window, (n,).
    """

    searched: ClassVar[bool] = False
    torque: float = 0.0
    begin: np.ndarray = field(default_factory=lambda: np.zeros(0))
    end: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def _key(self) -> tuple[str, float, bytes, bytes]:
        return self.target, self.torque, self.begin.tobytes(), self.end.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TorquePulse) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def force(self, qpos: np.ndarray, qvel: np.ndarray, time: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.at(time[:, None]), qpos.shape)

    def at(self, time: np.ndarray) -> np.ndarray:
        """The torque at times of each window, (n, k)."""
        now = (time > self.begin[:, None] - 1e-9) & (time < self.end[:, None] - 1e-9)
        return self.torque * now


def periodic_starts(
    sim: Simulator, windows: Windows, c: Candidate, left: np.ndarray, change: Callable[[Effect], np.ndarray]
) -> tuple[tuple[float, ...], ...]:
    """Where fits of a cogging torque start: the numbers of periods that explain most of a residual, with amplitudes.

    A torque in each part of a window changes its prediction linearly. So the change by any torque over the angle is a
    weighted sum of few simulations, and all numbers of periods are compared without simulating them (a periodogram,
    Lomb 1976, of torques that are seen through the motion).

    Args:
        sim: with the recordings.
        windows: n of them.
        c: the candidate; its bounds say which numbers of periods are possible.
        left: whitened residual, (rows,).
        change: of the whitened residual by an effect, (rows,).

    Returns:
        (sine, cosine, periods) for each of the best.
    """
    columns = sim.model.joint(c.target).qposadr[0]
    last, torque = int(windows.offsets[-1]), c.scale[0]
    pairs = list(zip(windows.episode, windows.start, strict=True))
    angle = np.stack([sim.data[e].qpos[s : s + last + 1, columns] for e, s in pairs])
    time = np.stack([sim.data[e].time[s : s + last + 1] for e, s in pairs])
    edges = np.unique(np.linspace(0, last, min(last, MOST_PULSES) + 1).round().astype(int))
    parts = list(pairwise(edges))
    answer = np.stack([change(TorquePulse(c.target, torque, time[:, a], time[:, b])) for a, b in parts]) / torque
    answer = answer.reshape(len(parts), len(windows), -1)
    low, high = c.bounds()
    spread = float(np.ptp(angle)) + 1e-9
    tried = np.arange(low[2], high[2], FINENESS / spread)
    gains, amplitudes = np.zeros(len(tried)), np.zeros((len(tried), 2))
    for i, n in enumerate(tried):
        waves = [np.stack([wave(n, angle[:, a : b + 1]) for a, b in parts], 1) for wave in (mean_sine, mean_cosine)]
        D = np.stack([np.einsum("kwr,wk->wr", answer, wave).ravel() for wave in waves], 1)
        H, g = D.T @ D, D.T @ left
        amplitudes[i] = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(2) + 1e-300 * np.eye(2), g)
        gains[i] = -2 * amplitudes[i] @ g - amplitudes[i] @ H @ amplitudes[i]
    best = highest_peaks(gains)
    return tuple((float(amplitudes[i][0]), float(amplitudes[i][1]), float(tried[i])) for i in best)


def mean_sine(n: float, angle: np.ndarray) -> np.ndarray:
    """Mean over time of sin(n q) between samples of q (..., k), along which it is linear: (...,)."""
    return between_samples(n, angle, lambda x: -np.cos(x), np.sin)


def mean_cosine(n: float, angle: np.ndarray) -> np.ndarray:
    """Mean over time of cos(n q) between samples of q (..., k), along which it is linear: (...,)."""
    return between_samples(n, angle, np.sin, np.cos)


def between_samples(n: float, angle: np.ndarray, integral: Callable, wave: Callable) -> np.ndarray:
    """Mean of a wave over the stretches between samples of the angle, (..., k), by its integral: (...,)."""
    a, b = n * angle[..., :-1], n * angle[..., 1:]
    still = np.abs(b - a) < 1e-4
    slope = (integral(b) - integral(a)) / np.where(still, 1.0, b - a)
    return np.where(still, wave((a + b) / 2), slope).mean(-1)


def highest_peaks(gains: np.ndarray) -> list[int]:
    """Where local maxima are, the highest first, at most :data:`PEAKS`."""
    padded = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:]))
    return sorted(peaks.tolist(), key=lambda i: -gains[i])[:PEAKS]

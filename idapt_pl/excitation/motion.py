"""Motions as bounded Fourier series: what is commanded over time, from a vector of numbers.

Each actuator's command is u(t) = u₀(t) + w(t) (c + Σₖ (aₖ sin 2πkt/T + bₖ cos 2πkt/T)), as in Swevers et al. 1997 and
later work on exciting trajectories for robot identification. The envelope w is 0 at both ends, so a motion starts and
ends with the command of the start pose. What would leave the command's range is scaled back as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HARMONICS = 6
"""Sines and cosines of every actuator."""

RAMP = 0.5
"""Seconds in which a motion begins and ends; a sixth of it where it is shorter."""

NO_ROOM = 0.05
"""Share of a command's range within which of its end a command that a motion is added to has no room there."""


@dataclass(frozen=True)
class FourierMotion:
    """Commands over time with free coefficients.

    Attributes:
        around: commands that the series is added to, (T, nu): those of the start pose, or recorded ones.
        command: lowest and highest command of each actuator, (nu, 2).
        control_period: s.
        harmonics: of each actuator, multiples of 1/(T dt), (nu, K).
    """

    around: np.ndarray
    command: np.ndarray
    control_period: float
    harmonics: np.ndarray

    @property
    def size(self) -> int:
        """Number of coefficients: an offset, sines and cosines of each actuator."""
        return int(self.harmonics.shape[0] * (1 + 2 * self.harmonics.shape[1]))

    def commands(self, x: np.ndarray) -> np.ndarray:
        """Commands of motions, (n, T, nu), from coefficients in units of half a command's range, (n, size)."""
        change = self.unbounded(x)
        bounded = self.around + change / self.overshoot(change)[:, None]
        return np.clip(bounded, self.command[:, 0], self.command[:, 1])

    def unbounded(self, x: np.ndarray) -> np.ndarray:
        """What coefficients add to the commands before it is scaled back, (n, T, nu)."""
        steps, nu = self.around.shape
        coefficients = np.asarray(x).reshape(len(x), nu, -1)
        phase = 2 * np.pi * np.arange(steps)[:, None, None] / steps * self.harmonics  # (T, nu, K)
        waves = np.concatenate([np.ones((steps, nu, 1)), np.sin(phase), np.cos(phase)], -1)
        series = np.einsum("nuk,tuk->ntu", coefficients, waves) * envelope(steps, self.control_period)[:, None]
        return series * (self.command[:, 1] - self.command[:, 0]) / 2

    def reachable(self, x: np.ndarray) -> np.ndarray:
        """Coefficients of the same motion (size,) that are not scaled back: half of them are half the motion."""
        ratio = self.overshoot(self.unbounded(x[None]))[0]
        return (x.reshape(len(ratio), -1) / ratio[:, None]).ravel()

    def overshoot(self, change: np.ndarray) -> np.ndarray:
        """By how much changes (n, T, nu) go beyond the room that commands have, at least 1, (n, nu).

        Where the base leaves next to no room, commands stay at their limit, and the rest of the motion is as it was.
        """
        room = np.where(change > 0, self.command[:, 1] - self.around, self.around - self.command[:, 0])
        narrow = room <= NO_ROOM * (self.command[:, 1] - self.command[:, 0])
        ratio = np.where(narrow, 0.0, np.abs(change) / np.where(narrow, 1.0, room))
        return np.maximum(ratio.max(1), 1.0)

    def random(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Coefficients of random motions, (n, size): small and large, slow and quick, some actuators barely moving."""
        nu, K = self.harmonics.shape
        falling = rng.uniform(0.0, 1.2, (n, nu, 1))
        waves = rng.standard_normal((n, nu, 2, K)) * self.harmonics[:, None] ** -falling[:, :, None]
        offset = rng.standard_normal((n, nu, 1))
        x = np.concatenate([0.5 * offset, waves.reshape(n, nu, 2 * K)], -1)
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        loudness = np.exp(rng.uniform(np.log(0.1), np.log(3.0), (n, 1, 1))) * rng.uniform(0.3, 1.0, (n, nu, 1))
        return (loudness * x).reshape(n, -1)


def envelope(steps: int, control_period: float) -> np.ndarray:
    """From 0 to 1 and back, smoothly, (steps,)."""
    ramp = max(1, min(round(RAMP / control_period), steps // 6))
    s = np.clip(np.arange(steps) / ramp, 0, 1)
    rise = s**3 * (10 - 15 * s + 6 * s**2)  # velocity and acceleration are 0 at both ends
    return rise * rise[::-1]


def fourier_motion(
    around: np.ndarray, command: np.ndarray, control_period: float, fastest: float, seed: int = 0
) -> FourierMotion:
    """A series whose frequencies reach from once a motion to ``fastest`` [Hz], other ones for every actuator.

    Args:
        around: commands that the series is added to, (T, nu).
        command: lowest and highest, (nu, 2).
        control_period: s.
        fastest: highest frequency, Hz.
        seed: of the choice of frequencies.
    """
    steps, nu = around.shape
    highest = max(1, int(min(fastest * steps * control_period, steps / 4)))
    count, rng = min(HARMONICS, highest), np.random.default_rng(seed)
    rows = []
    for _ in range(nu):
        edges = np.geomspace(1, highest, count)
        jitter = np.concatenate([[1.0], np.exp(rng.uniform(-0.15, 0.15, count - 1))])
        rows.append(spread(np.round(edges * jitter).astype(int), highest))
    return FourierMotion(around, command, control_period, np.array(rows))


def spread(harmonics: np.ndarray, highest: int) -> np.ndarray:
    """The same harmonics, each once, none above the highest."""
    taken: list[int] = []
    for k in np.sort(harmonics):
        free = [h for h in range(1, highest + 1) if h not in taken]
        taken.append(min(free, key=lambda h: abs(h - k)))
    return np.sort(taken)

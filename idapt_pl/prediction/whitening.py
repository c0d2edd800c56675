"""Whitening: residuals of windows in units in which the right model leaves independent noise of variance 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.estimation.intervals import clusters_of
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects, Simulator

FEW_DRAWS, MOST_DRAWS = 4, 32
"""First states drawn at random for what is beyond second order: at first, and in all where these find something."""

SOMETHING, SOME_WINDOWS = 0.3, 0.05
"""What is beyond second order counts where it is this much (rms, in sigma) in more than this share of the windows."""


@dataclass(frozen=True)
class InitialStateSensitivity:
    """How residuals depend on the first state of their window, by central differences of a finite size.

    Attributes:
        slope: d residual / d first state, (n, j, channels, 2 nv).
        bend: half the second derivative, along each coordinate, (n, j, channels, 2 nv). Small where things are smooth,
            large where the noise decides when a contact begins.
        rest: what the noise changes beyond that, (n, j, channels, draws): the sum of its squares is the variance. Large
            where feet, end stops or friction make it grow from one contact to the next.
    """

    slope: np.ndarray
    bend: np.ndarray
    rest: np.ndarray


def initial_sensitivity(
    sim: Simulator, effects: Effects, windows: Windows, size: np.ndarray, draw: bool = True
) -> InitialStateSensitivity:
    """The sensitivity to changes of the first state by ``size``, (2 nv,): of the order of its noise.

    ``draw``: find out what is beyond second order, too; else there is no column of it.
    """
    base, slope, bend = sim.residual(effects, windows), [], []
    nudges = [n for nudge in np.diag(size) for n in (nudge, -nudge)]
    moved = iter(sim.side_by_side.map(lambda n: sim.residual(effects, windows, n), nudges))
    for s, above, below in zip(size, moved, moved, strict=True):
        slope.append((above - below) / (2 * s))
        bend.append((above + below - 2 * base) / (2 * s**2))
    smooth = np.stack(slope, -1), np.stack(bend, -1)
    nothing = np.zeros((*base.shape, 0))
    rest = beyond_second_order(sim, effects, windows, size, base, *smooth) if draw else nothing
    return InitialStateSensitivity(*smooth, rest)


def beyond_second_order(
    sim: Simulator, effects: Effects, windows: Windows, size: np.ndarray, base: np.ndarray, slope: np.ndarray,
    bend: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """What first states drawn at random change in residuals that slope and bend do not foretell.

    Args:
        sim: of the nominal model.
        effects: of the current one.
        windows: of the recordings.
        size: standard deviations of first states, (2 nv,).
        base: residuals, (n, j, channels).
        slope: of these, (n, j, channels, 2 nv).
        bend: likewise.

    Returns:
        As ``rest`` of :class:`InitialStateSensitivity`.
    """
    drawn, rest = np.random.default_rng(0).normal(size=(MOST_DRAWS, len(size))) * size, list[np.ndarray]()
    for some in (drawn[:FEW_DRAWS], drawn[FEW_DRAWS:]):
        moved = sim.side_by_side.map(lambda n: sim.residual(effects, windows, n), some)
        rest += [r - base - slope @ n - bend @ np.square(n) for n, r in zip(some, moved, strict=True)]
        in_sigma = np.sqrt(np.mean([np.square(r / size[: r.shape[-1]]) for r in rest], (0, 2, 3)))
        if np.mean(in_sigma > SOMETHING) <= SOME_WINDOWS:
            break
    return np.stack(rest, -1) / np.sqrt(len(rest))


def whitener(at: InitialStateSensitivity, noise: Noise, compared: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """W_k with W_k r_k white under the model, W = chol(R)⁻¹, (n, rows, j channels): a row for what is compared.

    R = Σ + S Σ₀ Sᵀ + 2 B Σ₀² Bᵀ + C Cᵀ: the sensors' noise, that of the first state to first and to second order, and
    what it does beyond that (``rest``). Without the last two, windows in which the noise decides whether and when a
    foot touches the floor would outweigh all others. Where a first velocity is a slope of positions, the noise of one
    of these may be compared as well (``offsets``: samples that are).
    """
    n, j, channels, _ = at.slope.shape
    rows = np.flatnonzero(np.tile(compared, j))
    S = np.concatenate([at.slope * noise.start, 2**0.5 * at.bend * np.square(noise.start), at.rest], -1)
    S = S.reshape(n, j * channels, -1)[:, rows]
    R = S @ S.transpose(0, 2, 1)
    R[:, np.arange(len(rows)), np.arange(len(rows))] += np.square(np.tile(noise.sensors, j)[rows])
    if noise.slope is not None:
        shared = np.zeros((n, j * channels, j * channels))
        for k in np.flatnonzero(offsets == noise.slope.reach):
            by_noise = at.slope[..., channels:] * np.square(noise.sensors) / noise.slope.seconds
            shared[:, :, k * channels : (k + 1) * channels] = by_noise.reshape(n, -1, channels)
        R += (shared + shared.transpose(0, 2, 1))[:, rows][:, :, rows]
    scale = np.sqrt(np.einsum("nii->ni", R))
    C = R / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(len(rows))
    W = np.zeros((n, len(rows), j * channels))
    W[:, :, rows] = np.linalg.inv(np.linalg.cholesky(C)) / scale[:, None, :]
    return W


def whiten(W: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Whitened rows: (n, j, channels) to (n, rows)."""
    return np.einsum("nab,nb->na", W, residual.reshape(len(residual), -1))


def moved_little(W: np.ndarray, before: np.ndarray, after: np.ndarray, share: float = 1.0) -> bool:
    """Whether a model's predictions moved by less (squared) than a share of what it leaves, before and after.

    Args:
        W: whitens residuals, (n, rows, j channels).
        before: residuals, (n, j, channels).
        after: the same later.
        share: of the lesser of what is left before and after.
    """
    one, other = whiten(W, before), whiten(W, after)
    left = min(float(np.square(one).sum()), float(np.square(other).sum()))
    return float(np.square(other - one).sum()) < share * left


@dataclass(frozen=True)
class WhitenedWindows:
    """Windows, with what whitens their residuals under the current model: (n, rows, residuals)."""

    windows: Windows
    W: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> WhitenedWindows:
        return replace(self, windows=self.windows[rows], W=self.W[rows])

    @property
    def clusters(self) -> np.ndarray:
        """Windows within which noise may be dependent, by a number each, (n,): those of an episode.

        One episode says nothing of how episodes differ, and two hardly anything: there it is those of a stretch.
        """
        return clusters_of(self.windows.episode, self.windows.start, enough=3)

    def unwhitened(self, sim: Simulator, effects: Effects) -> np.ndarray:
        """What is whitened: what was measured minus what is predicted, (n, j, channels)."""
        return sim.residual(effects, self.windows)

    def residual(self, sim: Simulator, effects: Effects) -> np.ndarray:
        """Whitened residuals under some effects, (n, rows)."""
        return whiten(self.W, self.unwhitened(sim, effects))

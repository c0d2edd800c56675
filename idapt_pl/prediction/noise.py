"""Noise of the sensors: given, or estimated from the recordings."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import nnls

from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.data import Recording, Windows, position_difference, slope_reach, slopes
from idapt_pl.prediction.simulator import Effects, Simulator

LEAST_OF_KIND = 0.5
"""Share of the median noise of sensors of its kind that a sensor has at least."""

BENT = 3.0
"""How many times what the motion's bending does to a slope counts, where windows begin with slopes of positions.

It is no noise: it goes with what the machine does, as a wrong mass does."""

NOISE_OF_WIDTHS = 2.5
"""Variance of how slopes over one and over two reaches differ by noise, in units of the positions' over one width²."""

FIRST_NUDGES = (1e-5, 1e-4)
"""Changes of a first position and velocity by which is seen, at first, how a residual depends on them."""

NOISE_PASSES = 2
"""How often noise is estimated from measured velocities: at first with slopes of tiny changes, then of its own size.

A leg on a stiff floor answers to tiny changes ten times as much as to noise, which lifts it."""

PRIOR_WEIGHT = 0.2
"""Weight of the first guess of a variance, in units of what a residual of every window weighs."""


@dataclass(frozen=True)
class SlopeOfPositions:
    """What a velocity that nobody measured is: the slope between two samples of the positions.

    Attributes:
        reach: samples to either side.
        seconds: between the two.
    """

    reach: int
    seconds: float


@dataclass(frozen=True)
class Noise:
    """Standard deviations: of every compared channel, and of the first state of a window (2 nv,).

    ``systematic`` are errors that are the same in all recordings, each as an effect of one standard deviation.
    Intervals of estimates allow for them; they are not looked for. ``forces`` (nv,) are what nothing explains of those
    on each degree of freedom, where models are judged by forces (:mod:`~idapt_pl.prediction.force_windows`), else None.
    ``slope`` tells which positions first velocities share their noise with, where these are slopes.
    """

    sensors: np.ndarray
    start: np.ndarray
    systematic: Effects = ()
    forces: np.ndarray | None = None
    slope: SlopeOfPositions | None = None


def smoothness_noise(model: mujoco.MjModel, data: list[Recording], velocities: bool) -> list[np.ndarray]:
    """An upper bound on the sensors' noise: what a cubic through neighbouring samples cannot follow."""
    weights = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    signals = [[position_difference(model, r.qpos[:1], r.qpos) for r in data], [r.qvel for r in data]]
    parts = []
    for episodes in signals if velocities else signals[:1]:
        each = [sum(w * x[i : len(x) - 4 + i] for i, w in enumerate(weights)) for x in episodes if len(x) > 5]
        rough = np.concatenate(each) if each else np.full((1, model.nv), np.inf)
        random = robust_deviation(rough - np.median(rough, 0)) / np.linalg.norm(weights)
        parts.append(np.maximum(random, rounding_noise(episodes)))
    return parts


def rounding_noise(episodes: list[np.ndarray]) -> np.ndarray:
    """Standard deviation of rounding, where a channel moves in steps of one size (counts of an encoder); else 0.

    A machine at rest shows the same count all the time: it has noise all the same.
    """
    steps = np.concatenate([np.abs(np.diff(x, axis=0)) for x in episodes if len(x) > 1])
    noise = np.zeros(steps.shape[1])
    for i, moved in enumerate(steps.T):
        moved = moved[moved > 1e-9]
        if len(moved) > 20:
            counts = moved / moved.min()
            noise[i] = moved.min() / 12**0.5 * (np.mean(np.abs(counts - counts.round()) < 0.05) > 0.95)
    return noise


def estimate_noise(sim: Simulator, effects: Effects, windows: Windows) -> Noise:
    """Noise that explains the typical residuals, no larger than the smoothness of the data allows.

    Where the model is wrong this is too large, so it is made again after each effect that is added.

    Args:
        sim: the simulator.
        effects: of the current model.
        windows: short ones, of two control steps where velocities were measured.
    """
    if sim.velocities:
        limit = np.concatenate(smoothness_noise(sim.model, sim.data, True))
        sigma = tiny = np.repeat(FIRST_NUDGES, sim.model.nv)
        for _ in range(NOISE_PASSES):
            residual, A = noise_from_steps(sim, effects, windows, np.maximum(sigma, tiny))
            sigma = bounded_noise(sim, 0.01 * limit + 1e-9, np.sqrt(fit_variances(A, residual)), limit)
        return Noise(sigma, sigma)
    slope, limit = slope_of(sim.data), smoothness_noise(sim.model, sim.data, False)[0]
    residual, A = noise_from_windows(sim, effects, windows, slope)
    fitted = np.sqrt(fit_variances(A, residual, shares_of_widths(sim, slope))[: sim.model.nv])
    low = 0.3 * limit + 1e-9  # windows of a wrong model say little of the sensors
    sensors = bounded_noise(sim, low, fitted, limit)
    start = np.hypot(2**0.5 * sensors / slope.seconds, BENT * slope_bending(sim))
    return Noise(sensors, np.concatenate([sensors, start]), slope=slope)


def bounded_noise(sim: Simulator, low: np.ndarray, sigma: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Estimates of positions' (and velocities') noise between bounds; none is less than its encoder's counts."""
    low, counts = low.copy(), rounding_noise([position_difference(sim.model, r.qpos[:1], r.qpos) for r in sim.data])
    low[: len(counts)] = np.maximum(low[: len(counts)], counts)
    return np.clip(shrink_to_kind(sim.model, sigma), low, np.maximum(high, low))


def shrink_to_kind(model: mujoco.MjModel, sigma: np.ndarray) -> np.ndarray:
    """No sensor is taken to be much better than the others of its kind (:data:`LEAST_OF_KIND`).

    Where stiff springs or contacts pass the noise of other channels on, a channel's own is a small part of what is
    seen, and the estimate of it may come out as nothing: all the rest would then count as evidence.

    Args:
        model: the model.
        sigma: of positions, (nv,), or of positions and of velocities, (2 nv,).
    """
    turns = np.concatenate([{0: [0] * 3 + [1] * 3, 1: [1] * 3, 2: [0], 3: [1]}[int(t)] for t in model.jnt_type])
    kind, out = np.concatenate([turns, 2 + turns])[: len(sigma)], sigma.copy()
    for k in np.unique(kind):
        out[kind == k] = np.maximum(sigma[kind == k], LEAST_OF_KIND * np.median(sigma[kind == k]))
    return out


def slope_of(data: list[Recording]) -> SlopeOfPositions:
    """Over which samples velocities are taken that were not measured."""
    reach = slope_reach(data[0].time)
    return SlopeOfPositions(reach, 2 * reach * float(np.median(np.diff(data[0].time))))


def width_difference(sim: Simulator) -> np.ndarray:
    """By how much slopes over one and over two reaches differ, standard deviation, (nv,)."""
    narrow, wide = (
        np.concatenate([slopes(sim.model, r.time, r.qpos, wider * slope_reach(r.time)) for r in sim.data])
        for wider in (1, 2)
    )
    return robust_deviation(narrow - wide)


def slope_bending(sim: Simulator) -> np.ndarray:
    """What the motion's own bending does to its slopes, standard deviation, (nv,): a third of how two widths differ.

    What noise does to that is in it: a first velocity is rather trusted too little.
    """
    return width_difference(sim) / 3


def shares_of_widths(sim: Simulator, slope: SlopeOfPositions) -> np.ndarray:
    """Of how slopes of two widths differ, the share per variance of positions and of bending, (nv, 2 nv)."""
    total = np.square(width_difference(sim)) + 1e-30
    return np.concatenate([np.diag(NOISE_OF_WIDTHS / slope.seconds**2 / total), np.diag(9 / total)], 1)


def noise_from_steps(
    sim: Simulator, effects: Effects, windows: Windows, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Changes from one single-step residual to the next, (n, 1, channels), and A with their variances A v.

    With noise n_k of sample k, a residual is n_{k+1} + S_k n_k. What the model gets wrong mostly lasts longer than a
    control step, and cancels in e_{k+1} - e_k = n_{k+2} + (S_{k+1} - 1) n_{k+1} - S_k n_k.
    S is over changes of that ``size``.
    """
    first, second = (Windows(windows.episode, windows.start + k, np.array([1])) for k in (0, 1))
    (e0, S0), (e1, S1) = (residual_slopes(sim, effects, w, size) for w in (first, second))
    one = np.eye(e0.shape[-1])
    return e1 - e0, one + np.square(S1 - one) + np.square(S0)


def noise_from_windows(
    sim: Simulator, effects: Effects, windows: Windows, slope: SlopeOfPositions
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of two samples, (n, 2, channels), and A with their variances A v, for positions alone.

    The velocity that a window starts with is a slope. So it has the noise of two positions, one of which may be
    compared as well, and what bending does to it, the second half of v.
    """
    residual, S = residual_slopes(sim, effects, windows, np.repeat(FIRST_NUDGES, sim.model.nv))
    S, nv = S[:, :2], sim.model.nv
    by_noise = S[..., nv:] / slope.seconds
    same = (windows.offsets[:2] == slope.reach)[:, None, None]
    A = np.square(np.eye(nv) + by_noise * same) + np.square(by_noise) * (2.0 - same) + np.square(S[..., :nv])
    return residual[:, :2], np.concatenate([A, np.square(S[..., nv:])], -1)


def residual_slopes(
    sim: Simulator, effects: Effects, windows: Windows, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n, j, channels) and their slopes over changes of the first state by ``size``, (..., 2 nv)."""
    two_sided = ((sim.residual(effects, windows, n), sim.residual(effects, windows, -n)) for n in np.diag(size))
    slopes_of = [(above - below) / (2 * s) for (above, below), s in zip(two_sided, size, strict=True)]
    return sim.residual(effects, windows), np.stack(slopes_of, -1)


def fit_variances(A: np.ndarray, residual: np.ndarray, shares: np.ndarray | None = None, rounds: int = 8) -> np.ndarray:
    """Non-negative v with Var(residual) = A v, from residuals of which some are outliers.

    Iteratively re-weighted least squares on the squares; beyond three sigma they do not count. A little weight on what
    is known besides settles what the residuals leave open.

    Args:
        A: (n, j, channels, p).
        residual: (n, j, channels).
        shares: rows that give 1 times v, (k, p); default is that all residuals are the sensors'.
        rounds: of re-weighting.
    """
    n, p = len(A), A.shape[-1]
    spread = np.square(robust_deviation(residual[:, 0])) + 1e-30
    guess = spread / np.median(A[:, 0], 0).diagonal()
    known = PRIOR_WEIGHT * np.sqrt(n) * (np.diag(1 / guess) if shares is None else shares)
    v, rows, squares = np.resize(guess, p), A.reshape(-1, p), np.square(residual).ravel() + 1e-30
    for _ in range(rounds):
        expected = rows @ v + 1e-30
        expected *= max(1.0, float(np.median(squares / expected)) / 0.455)  # the median of chi²
        keep = squares < 9 * expected
        left, right = rows[keep] / expected[keep, None], squares[keep] / expected[keep] / 0.973
        told = np.full(len(known), PRIOR_WEIGHT * np.sqrt(n))
        v, _ = nnls(np.concatenate([left, known]), np.concatenate([right, told]), maxiter=100 * p)
    return v

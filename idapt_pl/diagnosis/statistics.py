"""Noise, whitening, robust loss, sensitivities and Gauss-Newton: what turns residuals into evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import nnls

from idapt_pl.diagnosis.data import Recording, Windows, difference
from idapt_pl.diagnosis.library import Candidate
from idapt_pl.diagnosis.simulator import Effects, Simulator

HUBER = 4.0
"""Whitened residuals beyond this many sigma count linearly: a few contacts must not decide."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations: of every compared channel, and of the first state of a window (2 nv,)."""

    sensors: np.ndarray
    start: np.ndarray


def initial_sensitivity(sim: Simulator, effects: Effects, windows: Windows, base: np.ndarray) -> np.ndarray:
    """D residual / d first state, (n, j, channels, 2 nv), by finite differences."""
    nv = sim.model.nv
    columns = []
    for i in range(2 * nv):
        nudge = np.zeros(2 * nv)
        nudge[i] = 1e-5 if i < nv else 1e-4
        columns.append((sim.residual(effects, windows, nudge) - base) / nudge[i])
    return np.stack(columns, -1)


def smoothness_noise(model: mujoco.MjModel, data: list[Recording], velocities: bool) -> list[np.ndarray]:
    """An upper bound on the sensors' noise: what a cubic through neighbouring samples cannot follow."""
    weights = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    signals = [[difference(model, r.qpos[:1], r.qpos) for r in data], [r.qvel for r in data]]
    parts = []
    for episodes in signals if velocities else signals[:1]:
        rough = [sum(w * x[i : len(x) - 4 + i] for i, w in enumerate(weights)) for x in episodes if len(x) > 5]
        rough = np.concatenate(rough) if rough else np.full((1, model.nv), np.inf)
        parts.append(1.4826 * np.median(np.abs(rough - np.median(rough, 0)), 0) / np.linalg.norm(weights))
    return parts


def estimate_noise(sim: Simulator, residual: np.ndarray, S0: np.ndarray) -> Noise:
    """Noise that explains the robust spread of the residuals, no larger than the smoothness of the data allows.

    Var(r_ji) = σ_i² + Σ_c S_jic² σ_c² is linear in the variances: non-negative least squares. Where the
    model is wrong this is too large, so it is made again after each effect that is added.
    """
    nv, channels = sim.model.nv, residual.shape[-1]
    residual, S0 = residual[:, :2], S0[:, :2]  # the earliest samples: less of the model, more of the sensors
    spread = np.square(1.4826 * np.median(np.abs(residual), 0)) + 1e-30  # (j, channels)
    through = np.median(np.square(S0), 0)  # (j, channels, 2 nv)
    own = np.broadcast_to(np.eye(channels), (len(spread), channels, channels))
    # measured velocities: the first state comes from the same sensors; else its velocity has a noise of its own
    A = own + through if sim.velocities else np.concatenate([own + through[..., :nv], through[..., nv:]], -1)
    A = (A / spread[..., None]).reshape(-1, A.shape[-1])
    variances, _ = nnls(A, np.ones(len(A)), maxiter=50 * A.shape[1])
    smooth = smoothness_noise(sim.model, sim.data, sim.velocities)
    limit = np.concatenate(smooth)
    limit = np.concatenate([limit, np.full(len(variances) - channels, np.inf)])
    low = 0.01 * np.where(np.isfinite(limit), limit, 0.0) + 1e-9
    sigma = np.clip(np.sqrt(variances), low, np.maximum(limit, low))
    if sim.velocities:
        return Noise(sigma, sigma)
    slope = np.maximum(sigma[channels:], 0.3 * sigma[:nv] / max(np.median(np.diff(sim.data[0].time)), 1e-6) * 0.1)
    return Noise(sigma[:channels], np.concatenate([sigma[:nv], slope]))


def whitener(S0: np.ndarray, noise: Noise) -> np.ndarray:
    """W_k with W_k r_k white under the model: R_k = Σ + S₀ Σ₀ S₀ᵀ, W = chol(R)⁻¹, (n, rows, rows)."""
    n, j, channels, _ = S0.shape
    S = S0.reshape(n, j * channels, -1) * noise.start
    R = S @ S.transpose(0, 2, 1)
    own = np.tile(noise.sensors, j)
    R[:, np.arange(j * channels), np.arange(j * channels)] += np.square(own)
    scale = np.sqrt(np.einsum("nii->ni", R))
    C = R / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(j * channels)
    return np.linalg.inv(np.linalg.cholesky(C)) / scale[:, None, :]


def whiten(W: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Whitened rows: (n, j, channels) to (n, rows)."""
    return np.einsum("nab,nb->na", W, residual.reshape(len(residual), -1))


def huber(z: np.ndarray) -> np.ndarray:
    """z² up to HUBER, then linear."""
    a = np.abs(z)
    return np.where(a <= HUBER, np.square(z), 2 * HUBER * a - HUBER**2)


def window_loss(z: np.ndarray) -> np.ndarray:
    """Mean robust loss of each window, 1 where the model is right and the noise as assumed; (n,)."""
    return huber(z).mean(1)


@dataclass(frozen=True)
class Fit:
    """A fit of some candidates.

    Attributes:
        x: their parameters, one array for each candidate.
        loss: mean robust loss on the windows fitted.
        J: d whitened residual / d (x / scale), (rows, p).
        z: whitened residuals, (n, rows a window).
    """

    x: tuple[np.ndarray, ...]
    loss: float
    J: np.ndarray
    z: np.ndarray


def effects_of(candidates: Sequence[Candidate], x: Sequence[np.ndarray]) -> Effects:
    """The effects with these parameters."""
    return tuple(c.effect(v) for c, v in zip(candidates, x, strict=True))


def jacobian(
    sim: Simulator, fixed: Effects, candidates: Sequence[Candidate], x: Sequence[np.ndarray], windows: Windows,
    W: np.ndarray, z: np.ndarray, step: float = 0.02,
) -> np.ndarray:  # fmt: skip
    """D z / d (x / scale), (n rows, p), by one-sided differences that stay inside the bounds."""
    columns = []
    for i, c in enumerate(candidates):
        _, high = c.bounds()
        for k in range(c.size):
            h = step * c.scale[k]
            h = -h if x[i][k] + h > high[k] else h
            moved = [v.copy() for v in x]
            moved[i][k] += h
            z_moved = whiten(W, sim.residual((*fixed, *effects_of(candidates, moved)), windows))
            columns.append((z_moved - z).ravel() / (h / c.scale[k]))
    return np.stack(columns, 1)


def gauss_newton(
    sim: Simulator, fixed: Effects, candidates: Sequence[Candidate], x: Sequence[np.ndarray], windows: Windows,
    W: np.ndarray, iterations: int = 8,
) -> Fit:  # fmt: skip
    """Iteratively re-weighted Levenberg-Marquardt through the simulator, in units of the scales, inside the bounds."""
    scale = np.concatenate([c.scale for c in candidates])
    splits = np.cumsum([c.size for c in candidates])[:-1]
    low, high = (np.concatenate(b) for b in zip(*(c.bounds() for c in candidates), strict=True))

    def at(v: np.ndarray) -> np.ndarray:
        return whiten(W, sim.residual((*fixed, *effects_of(candidates, np.split(v, splits))), windows))

    v = np.clip(np.concatenate([np.asarray(a, float) for a in x]), low, high)
    z = at(v)
    loss, damping = float(window_loss(z).mean()), 1e-3
    J = None
    for _ in range(iterations):
        J = jacobian(sim, fixed, candidates, np.split(v, splits), windows, W, z)
        weight = 1.0 / np.maximum(1.0, np.abs(z.ravel()) / HUBER)
        g, H = J.T @ (weight * z.ravel()), J.T @ (weight[:, None] * J)
        improved = False
        for _ in range(4):
            damped = H + damping * np.diag(np.diag(H) + 1e-12)
            free = ~(((v <= low) & (g > 0)) | ((v >= high) & (g < 0)))
            move = np.zeros_like(v)
            if free.any():
                move[free] = -np.linalg.lstsq(damped[np.ix_(free, free)], g[free], rcond=1e-12)[0]
            trial = np.clip(v + np.clip(move, -20, 20) * scale, low, high)
            z_trial = at(trial)
            trial_loss = float(window_loss(z_trial).mean())
            if trial_loss < loss:
                improved = True
                break
            damping = max(10 * damping, 1e-2)
        if not improved:
            break
        gain = loss - trial_loss
        v, z, loss, damping = trial, z_trial, trial_loss, damping / 5
        if gain < 1e-4 * loss:
            break
    J = jacobian(sim, fixed, candidates, np.split(v, splits), windows, W, z)
    return Fit(tuple(np.split(v, splits)), loss, J, z)


def covariance(fit: Fit, clusters: np.ndarray) -> np.ndarray:
    """Sandwich covariance of x / scale, clustered (episodes): robust to what the noise model gets wrong."""
    rows = fit.z.shape[1]
    weight = 1.0 / np.maximum(1.0, np.abs(fit.z.ravel()) / HUBER)
    bread = np.linalg.pinv(fit.J.T @ (weight[:, None] * fit.J))
    scores = (fit.J * (weight * fit.z.ravel())[:, None]).reshape(len(fit.z), rows, -1).sum(1)
    names = np.unique(clusters)
    g = np.stack([scores[clusters == c].sum(0) for c in names])
    correction = len(names) / max(len(names) - 1, 1)
    return correction * bread @ (g.T @ g) @ bread


def paired_gain(before: np.ndarray, after: np.ndarray, clusters: np.ndarray) -> tuple[float, float]:
    """Mean of before - after over windows, and its standard error.

    Windows do not overlap, so their noise is independent. That some episodes show an effect more than others is
    no reason to doubt it; if it helps in fewer than half of them, the error returned is infinite.
    """
    gain = before - after
    helped = np.mean([gain[clusters == c].mean() > 0 for c in np.unique(clusters)])
    error = float(gain.std() / np.sqrt(len(gain)))
    return float(gain.mean()), error if helped >= 0.5 or gain.mean() <= 0 else float("inf")

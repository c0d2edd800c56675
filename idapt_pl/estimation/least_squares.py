"""Robust least squares: Huber's loss and Gauss-Newton inside bounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.simulator import Effects
from idapt_pl.effects.candidate import Candidate

Predict = Callable[[Effects], np.ndarray]
"""Whitened residuals under some effects, (n, rows)."""

FAR_OFF = 2.0
"""Loss above which a step that helped is tried at twice its length."""

HUBER = 4.0
"""Whitened residuals beyond this many sigma count linearly: a few contacts must not decide."""


def huber(z: np.ndarray) -> np.ndarray:
    """z² up to HUBER, then linear."""
    a = np.abs(z)
    return np.where(a <= HUBER, np.square(z), 2 * HUBER * a - HUBER**2)


def robust_loss(z: np.ndarray) -> np.ndarray:
    """Mean robust loss of each window, 1 where the model is right and the noise as assumed; (n,)."""
    return huber(z).mean(1)


@dataclass(frozen=True)
class LeastSquaresFit:
    """A fit of some candidates.

    Attributes:
        x: their parameters, one array for each candidate.
        loss: mean robust loss on the windows fitted.
        J: d whitened residual / d (x / scale) where the last step began, (rows, p).
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
    z: Predict, fixed: Effects, candidates: Sequence[Candidate], x: Sequence[np.ndarray], base: np.ndarray,
    step: float = 0.02,
) -> np.ndarray:  # fmt: skip
    """D z / d (x / scale), (n rows, p), by one-sided differences that stay inside the bounds; ``base`` is z at x."""
    columns = []
    for i, c in enumerate(candidates):
        _, high = c.bounds()
        for k in range(c.size):
            h = step * c.scale[k]
            h = -h if x[i][k] + h > high[k] else h
            moved = [v.copy() for v in x]
            moved[i][k] += h
            columns.append((z((*fixed, *effects_of(candidates, moved))) - base).ravel() / (h / c.scale[k]))
    return np.stack(columns, 1)


def gauss_newton(
    z: Predict, fixed: Effects, candidates: Sequence[Candidate], x: Sequence[np.ndarray], iterations: int = 8
) -> LeastSquaresFit:
    """Iteratively re-weighted Levenberg-Marquardt through the simulator, in units of the scales, inside the bounds.

    Args:
        z: whitened residuals under some effects, (n, rows).
        fixed: effects that are not fitted.
        candidates: effects that are.
        x: where to start, one array for each candidate.
        iterations: at most so many.
    """
    scale = np.concatenate([c.scale for c in candidates])
    splits = np.cumsum([c.size for c in candidates])[:-1]
    low, high = (np.concatenate(b) for b in zip(*(c.bounds() for c in candidates), strict=True))

    def at(v: np.ndarray) -> np.ndarray:
        return z((*fixed, *effects_of(candidates, np.split(v, splits))))

    v = np.clip(np.concatenate([np.asarray(a, float) for a in x]), low, high)
    now = at(v)
    loss, damping = float(robust_loss(now).mean()), 1e-3
    for _ in range(iterations):
        J = jacobian(z, fixed, candidates, np.split(v, splits), now)
        weight = 1.0 / np.maximum(1.0, np.abs(now.ravel()) / HUBER)
        g, H = J.T @ (weight * now.ravel()), J.T @ (weight[:, None] * J)
        improved = False
        for _ in range(4):
            trial = step_to(v, g, H + damping * np.diag(np.diag(H) + 1e-12), scale, low, high)
            z_trial = at(trial)
            trial_loss = float(robust_loss(z_trial).mean())
            if trial_loss < loss:
                improved = True
                break
            damping = max(10 * damping, 1e-2)
        if not improved:
            break
        while trial_loss > FAR_OFF:  # contacts make slopes steeper than what they lead to: does more help more?
            further = np.clip(2 * trial - v, low, high)
            z_further = at(further)
            further_loss = float(robust_loss(z_further).mean())
            if further_loss > 0.99 * trial_loss:
                break
            trial, z_trial, trial_loss = further, z_further, further_loss
        gain = loss - trial_loss
        v, now, loss, damping = trial, z_trial, trial_loss, damping / 5
        if gain < 1e-4 * loss:
            break
    return LeastSquaresFit(tuple(np.split(v, splits)), loss, J, now)


def step_to(
    v: np.ndarray, g: np.ndarray, H: np.ndarray, scale: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Where a damped step leads, at most 20 scales away; parameters at a bound that push against it stay."""
    free = ~(((v <= low) & (g > 0)) | ((v >= high) & (g < 0)))
    move = np.zeros_like(v)
    if free.any():
        move[free] = -np.linalg.lstsq(H[np.ix_(free, free)], g[free], rcond=1e-12)[0]
    return np.clip(v + np.clip(move, -20, 20) * scale, low, high)


def influence(fit: LeastSquaresFit) -> tuple[np.ndarray, np.ndarray]:
    """How x / scale moves with whitened residuals, but for the sign: (JᵀWJ)⁻¹, (p, p), and W J, (n rows, p)."""
    weight = 1.0 / np.maximum(1.0, np.abs(fit.z.ravel()) / HUBER)
    return np.linalg.pinv(fit.J.T @ (weight[:, None] * fit.J)), weight[:, None] * fit.J

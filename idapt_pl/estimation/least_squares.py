"""Robust least squares: Huber's loss and weights, weighted normal equations, Gauss-Newton inside bounds.

Works on plain arrays and a function from parameters to residuals; knows nothing of models or effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Residual = Callable[[np.ndarray], np.ndarray]
"""Parameters (p,) to residuals (n, rows), in units of their noise."""

HUBER = 4.0
"""Residuals beyond this many sigma count linearly: a few contacts must not decide."""

FAR_OFF = 2.0
"""Loss above which a step that helped is tried at twice its length."""

LONGEST_STEP = 20.0
"""Scales that one step changes a parameter by at most."""


def huber(z: np.ndarray) -> np.ndarray:
    """z² up to HUBER, then linear (twice Huber's loss, 1964)."""
    a = np.abs(z)
    return np.where(a <= HUBER, np.square(z), 2 * HUBER * a - HUBER**2)


def robust_loss(z: np.ndarray) -> np.ndarray:
    """Mean robust loss of each window, 1 where the model is right and the noise as assumed: (n, rows) to (n,)."""
    return huber(z).mean(1)


def huber_weights(z: np.ndarray, threshold: float = HUBER) -> np.ndarray:
    """Weights with which least squares minimises Huber's loss: 1 up to ``threshold``, beyond it as 1/|z|."""
    return 1.0 / np.maximum(1.0, np.abs(z) / threshold)


def normal_equations(J: np.ndarray, z: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Jᵀ W J, (p, p), and Jᵀ W z, (p,), from J (rows, p), z (rows,) and the diagonal of W (rows,)."""
    return J.T @ (weights[:, None] * J), J.T @ (weights * z)


def project_out(basis: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The part of v (..., rows, k) that is orthogonal to a basis (..., rows, q) with orthonormal columns.

    What nuisance parameters could explain is taken away before the others are fitted (variable projection, Golub &
    Pereyra 1973).
    """
    return v - basis @ (np.swapaxes(basis, -1, -2) @ v)


@dataclass(frozen=True)
class ParameterBox:
    """What parameters can be.

    Attributes:
        scale: what a noticeable change of each is about, (p,); steps are in units of it.
        low: lower bounds, (p,).
        high: upper bounds, (p,).
    """

    scale: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def clip(self, x: np.ndarray) -> np.ndarray:
        """Parameters inside the bounds."""
        return np.clip(x, self.low, self.high)

    def step(self, x: np.ndarray, move: np.ndarray, longest: float) -> np.ndarray:
        """Where a step in units of the scales leads, no longer than ``longest`` of them and inside the bounds."""
        return self.clip(x + np.clip(move, -longest, longest) * self.scale)


@dataclass(frozen=True)
class LeastSquaresFit:
    """Outcome of a fit.

    Attributes:
        x: parameters, (p,).
        loss: mean robust loss.
        J: d residual / d (x / scale) where the last step began, (n rows, p).
        z: residuals at x, (n, rows).
    """

    x: np.ndarray
    loss: float
    J: np.ndarray
    z: np.ndarray


@dataclass(frozen=True)
class _Point:
    """Parameters, with the residuals and the loss there."""

    x: np.ndarray
    z: np.ndarray
    loss: float

    @classmethod
    def at(cls, residual: Residual, x: np.ndarray) -> _Point:
        z = residual(x)
        return cls(x, z, float(robust_loss(z).mean()))


def gauss_newton(residual: Residual, x: np.ndarray, box: ParameterBox, iterations: int = 8) -> LeastSquaresFit:
    """Minimise Huber's loss: iteratively re-weighted Levenberg-Marquardt inside bounds, with numeric derivatives.

    Args:
        residual: what to make small.
        x: where to start, (p,).
        box: scales and bounds.
        iterations: at most so many, at least 1.
    """
    now, damping = _Point.at(residual, box.clip(x)), 1e-3
    for _ in range(iterations):
        J = jacobian(residual, now.x, now.z, box)
        better, damping = _damped_step(residual, now, J, box, damping)
        if better is None:
            break
        better = _twice_as_far(residual, now, better, box)
        gain = now.loss - better.loss
        now, damping = better, damping / 5
        if gain < 1e-4 * now.loss:
            break
    return LeastSquaresFit(now.x, now.loss, J, now.z)


def jacobian(residual: Residual, x: np.ndarray, base: np.ndarray, box: ParameterBox, step: float = 0.02) -> np.ndarray:
    """D residual / d (x / scale), (n rows, p), by one-sided differences inside the bounds; ``base`` is that at x."""
    columns = []
    for k in range(len(x)):
        h = step * box.scale[k]
        h = -h if x[k] + h > box.high[k] else h
        moved = x.copy()
        moved[k] += h
        columns.append((residual(moved) - base).ravel() / (h / box.scale[k]))
    return np.stack(columns, 1)


def _damped_step(
    residual: Residual, now: _Point, J: np.ndarray, box: ParameterBox, damping: float
) -> tuple[_Point | None, float]:
    """A step that helps, damped ever more until it does, or None; and the damping it took."""
    z = now.z.ravel()
    H, g = normal_equations(J, z, huber_weights(z))
    for _ in range(4):
        move = _free_move(now.x, g, H + damping * np.diag(np.diag(H) + 1e-12), box)
        trial = _Point.at(residual, box.step(now.x, move, LONGEST_STEP))
        if trial.loss < now.loss:
            return trial, damping
        damping = max(10 * damping, 1e-2)
    return None, damping


def _free_move(x: np.ndarray, g: np.ndarray, H: np.ndarray, box: ParameterBox) -> np.ndarray:
    """The solution of H move = -g; parameters at a bound that push against it stay."""
    free = ~(((x <= box.low) & (g > 0)) | ((x >= box.high) & (g < 0)))
    move = np.zeros_like(x)
    if free.any():
        move[free] = -np.linalg.lstsq(H[np.ix_(free, free)], g[free], rcond=1e-12)[0]
    return move


def _twice_as_far(residual: Residual, before: _Point, after: _Point, box: ParameterBox) -> _Point:
    """Far from the minimum, go on in the same direction while more helps more.

    Contacts make slopes steeper than what they lead to.
    """
    while after.loss > FAR_OFF:
        further = _Point.at(residual, box.clip(2 * after.x - before.x))
        if further.loss > 0.99 * after.loss:
            break
        after = further
    return after

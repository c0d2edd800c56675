"""Robust least squares: Huber's loss and weights, weighted normal equations, Gauss-Newton inside bounds.

Works on plain arrays and a function from parameters to residuals; knows nothing of models or effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Residual = Callable[[np.ndarray], np.ndarray]
"""Parameters (p,) to residuals (n, rows), in units of their noise."""

Everywhere = Callable[[Residual, Sequence[np.ndarray]], list[np.ndarray]]
"""Residuals at several places, in their order; they may be asked for side by side."""

HUBER = 4.0
"""Residuals beyond this many sigma count linearly: a few contacts must not decide."""

FAR_OFF = 2.0
"""Loss above which a step that helped is tried at twice its length."""

CONVERGED = 1e-4
"""Share of the loss that a step with measured slopes must gain for another to be tried."""

FADING = 2e-3
"""The same of a step with corrected slopes: they are measured anew where it gains less,"""

KEPT_PROMISE = 0.3
"""or less than this of what they promised."""

SMALL_STEP = 0.02
"""Scales by which a parameter is moved to measure a slope."""

LONGEST_STEP = 20.0
"""Scales that one step changes a parameter by at most."""

BENEFIT_OF_THE_DOUBT = 3.0
"""How many times what the slopes promise a fit may still gain, for all that is known, when it is about to be left."""


OUT_OF_LINE = 10.0
"""Times the slope of nine of ten windows that one window's may be, at most, where slopes say which way to go."""

OUTLIER, FEW = 10.0, 0.05
"""Times their median from which on windows' losses are out of line, where no more than this share of them are."""


def one_by_one(residual: Residual, places: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Residuals at several places, one after the other."""
    return [residual(x) for x in places]


def huber(z: np.ndarray) -> np.ndarray:
    """z² up to HUBER, then linear (twice Huber's loss, 1964)."""
    a = np.abs(z)
    return np.where(a <= HUBER, np.square(z), 2 * HUBER * a - HUBER**2)


def robust_loss(z: np.ndarray) -> np.ndarray:
    """Mean robust loss of each window, 1 where the model is right and the noise as assumed: (n, rows) to (n,)."""
    return huber(z).mean(1)


def usual_windows(losses: np.ndarray) -> np.ndarray:
    """Windows whose loss is not out of line, by a mark each, (n,); all where more than a few would be.

    Where the noise decides when a foot touches the floor, one window of fifty may leave a hundred times what the others
    do under the right model, and hold most of the error. Where many do, something is missing.
    """
    usual = losses <= OUTLIER * np.median(losses)
    return usual if np.mean(~usual) <= FEW else np.ones(len(losses), bool)


def typical_loss(losses: np.ndarray) -> float:
    """Mean of the losses of windows, (n,), that are not out of line."""
    return float(losses[usual_windows(losses)].mean())


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
        J: d residual / d (x / scale) there, (n rows, p).
        z: residuals at x, (n, rows).
        given_up: whether it was left, as it would not have become good enough.
    """

    x: np.ndarray
    loss: float
    J: np.ndarray
    z: np.ndarray
    given_up: bool = False


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


def gauss_newton(
    residual: Residual,
    x: np.ndarray,
    box: ParameterBox,
    iterations: int = 8,
    exact: bool = False,
    slopes: np.ndarray | None = None,
    good_enough: float = np.inf,
    cheaper: Residual | None = None,
    everywhere: Everywhere = one_by_one,
) -> LeastSquaresFit:
    """Minimise Huber's loss: iteratively re-weighted Levenberg-Marquardt inside bounds, with numeric derivatives.

    Slopes are measured where the fit starts, and again where steps no longer do what these promise. In between every
    step corrects them (Broyden's rank-one update, 1965), which costs nothing.

    Args:
        residual: what to make small.
        x: where to start, (p,).
        box: scales and bounds.
        iterations: steps at most, at least 1.
        exact: measure the slopes once more where the fit ends. Else they are what the steps made of them.
        slopes: by the first parameters, known from elsewhere, (n rows, q): only the others' are measured at first.
        good_enough: loss that is asked for. A fit that would not come there, by far, is left.
        cheaper: about the same residuals, with which slopes are measured as long as these lead anywhere.
        everywhere: how residuals at several places are asked for.
    """
    now, damping = _Point.at(residual, box.clip(x)), 1e-3
    J, fresh = _slopes(residual, now, box, cheaper, everywhere, slopes), slopes is None or not slopes.size
    for k in range(iterations):
        if k and not fresh and _hopeless(now, J, box, good_enough):  # slopes that steps corrected may be wrong
            J, fresh = _slopes(residual, now, box, cheaper, everywhere), True
        if _hopeless(now, J, box, good_enough):
            return LeastSquaresFit(now.x, now.loss, J, now.z, given_up=True)
        better, damping = _damped_step(residual, now, J, box, damping, tries=4 if fresh else 1)
        gain, kept = 0.0, 0.0
        if better is not None:
            kept = (now.loss - better.loss) / max(_promised_gain(now, J, (better.x - now.x) / box.scale), 1e-300)
            better = _twice_as_far(residual, now, better, box)
            gain = (now.loss - better.loss) / now.loss
            J = broyden(J, (better.x - now.x) / box.scale, (better.z - now.z).ravel())
            now, damping = better, damping / 5
        if gain < CONVERGED and fresh and (better is not None or cheaper is None):
            fresh = better is None
            break
        cheaper = None if fresh and better is None else cheaper  # its slopes lead nowhere
        fresh = (gain < FADING or kept < KEPT_PROMISE) and k + 1 < iterations
        if fresh:
            J = _slopes(residual, now, box, cheaper, everywhere)
    if exact:
        J = jacobian(residual, now.x, now.z, box, everywhere=everywhere)
    return LeastSquaresFit(now.x, now.loss, J, now.z)


def kept_in_line(J: np.ndarray, windows: int) -> np.ndarray:
    """Slopes, (rows, p), in which no window is far out of line: there a foot leaves the ground, or stays, by a hair.

    Nothing is changed where nine of ten windows do not depend on a parameter.
    """
    each = J.reshape(windows, -1, J.shape[1])
    size = np.sqrt(np.square(each).sum(1))
    most = OUT_OF_LINE * np.quantile(size, 0.9, axis=0)
    share = np.where((size > most) & (most > 0), most / np.maximum(size, 1e-300), 1.0)
    return J if (share == 1.0).all() else (each * share[:, None]).reshape(J.shape)


def _slopes(
    residual: Residual, now: _Point, box: ParameterBox, cheaper: Residual | None, everywhere: Everywhere,
    known: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Slopes at a point, (n rows, p), by the cheaper residuals where there are such; none out of line."""
    if cheaper is None:
        J = jacobian(residual, now.x, now.z, box, known, everywhere)
    else:
        J = jacobian(cheaper, now.x, cheaper(now.x), box, known, everywhere)
    return kept_in_line(J, len(now.z))


def _hopeless(now: _Point, J: np.ndarray, box: ParameterBox, good_enough: float) -> bool:
    """Whether the minimum would leave more than is asked for, even if slopes promise far too little."""
    if now.loss <= good_enough:
        return False
    z = now.z.ravel()
    H, g = normal_equations(J, z, huber_weights(z))
    minimum = box.step(now.x, _free_move(now.x, g, H, box), np.inf)
    return now.loss - BENEFIT_OF_THE_DOUBT * _promised_gain(now, J, (minimum - now.x) / box.scale) > good_enough


def _promised_gain(now: _Point, J: np.ndarray, step: np.ndarray) -> float:
    """What a step (p,) takes from the loss if slopes are right."""
    z = now.z.ravel()
    return float(huber_weights(z) @ (np.square(z) - np.square(z + J @ step))) / z.size


def broyden(J: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Slopes (rows, p) that say of a step (p,) what it did to residuals, (rows,), and else what they said before."""
    return J + np.outer(change - J @ step, step / (step @ step))


def jacobian(
    residual: Residual,
    x: np.ndarray,
    base: np.ndarray,
    box: ParameterBox,
    known: np.ndarray | None = None,
    everywhere: Everywhere = one_by_one,
) -> np.ndarray:
    """D residual / d (x / scale), (n rows, p), by one-sided differences inside the bounds.

    Args:
        residual: of which.
        x: where, (p,).
        base: the residual there, (n, rows).
        box: scales and bounds.
        known: the first columns, where they need not be measured, (n rows, q).
        everywhere: how residuals at several places are asked for.
    """
    columns = [] if known is None else list(known.T)
    steps = {k: SMALL_STEP * box.scale[k] for k in range(len(columns), len(x))}
    steps = {k: -h if x[k] + h > box.high[k] else h for k, h in steps.items()}
    moved = [x + h * (np.arange(len(x)) == k) for k, h in steps.items()]
    for (k, h), z in zip(steps.items(), everywhere(residual, moved), strict=True):
        columns.append((z - base).ravel() / (h / box.scale[k]))
    return np.stack(columns, 1)


def _damped_step(
    residual: Residual, now: _Point, J: np.ndarray, box: ParameterBox, damping: float, tries: int
) -> tuple[_Point | None, float]:
    """A step that helps, damped ever more until it does, or None; and the damping it took."""
    z = now.z.ravel()
    H, g = normal_equations(J, z, huber_weights(z))
    for _ in range(tries):
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

    Contacts make slopes steeper than what they lead to. What a step did to the residuals tells, too, whether its double
    is nearer to the least of them.
    """
    while after.loss > FAR_OFF and _best_length(before, after) > 1.5:
        further = _Point.at(residual, box.clip(2 * after.x - before.x))
        if further.loss > 0.99 * after.loss:
            break
        after = further
    return after


def _best_length(before: _Point, after: _Point) -> float:
    """How many times a step had best been taken, if residuals went on changing as they did."""
    z, change = before.z.ravel(), (after.z - before.z).ravel()
    weighted = huber_weights(after.z.ravel()) * change
    return float(-(weighted @ z) / max(weighted @ change, 1e-300))

"""Fits visual parameters to a mean picture: least squares on pixels, from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import OptimizeResult, least_squares

from idapt_pl.appearance.first_frames import MeanImage, ParameterValues
from idapt_pl.appearance.parameters import VisualParameter

PIXEL = 1 / 255
PIXEL_ERROR = 2 * PIXEL
"""What a pixel errs by even where everything is right: rounding, edges."""
CORRELATED_PIXELS = 9.0
"""Neighbouring pixels whose errors go together."""
FIRST_MOVE = 10.0
"""Noticeable steps that the first move of a search may be long."""
RenderMean = Callable[[ParameterValues, bool], np.ndarray]
"""Values of the parameters, and whether a few starts will do, to a mean picture (H, W, 3), 0 to 1."""


@dataclass(frozen=True)
class AppearanceFit:
    """Visual parameters as fitted.

    Attributes:
        values: parameter to its values.
        std: parameter to their standard deviations, given that all that is wrong is among these parameters.
    """

    values: ParameterValues
    std: ParameterValues


def pixel_weights(measured: MeanImage, model_variance: np.ndarray) -> np.ndarray:
    """One over the standard deviation of a pixel's difference, (H, W, 3): what moves between starts counts less."""
    return 1 / np.sqrt(PIXEL_ERROR**2 + measured.variance + model_variance)


def fit_parameters(
    render: RenderMean, measured: MeanImage, model_variance: np.ndarray, start: ParameterValues,
    held: ParameterValues, coarse: bool = True, iterations: int = 4,
) -> AppearanceFit:  # fmt: skip
    """Change parameters until the rendered mean picture is most like the measured one.

    Args:
        render: makes the mean picture.
        measured: what it should be.
        model_variance: of the rendered mean, from the spread of its starts.
        start: the parameters to be fitted, and from where.
        held: parameters that stay as they are.
        coarse: begin with blurred pictures, where one of the parameters asks for it.
        iterations: steps at each level.
    """
    fitted = list(start)
    step, low, high = (np.concatenate([getattr(p, n) for p in fitted]) for n in ("step", "low", "high"))
    central = np.concatenate([np.full(len(p.nominal), p.rank > 0) for p in fitted])
    x = np.clip(np.concatenate([start[p] for p in fitted]), low, high)
    w = pixel_weights(measured, model_variance)

    def split(values: np.ndarray) -> dict[VisualParameter, np.ndarray]:
        ends = np.cumsum([len(p.nominal) for p in fitted])[:-1]
        return dict(zip(fitted, np.split(values, ends), strict=True))

    def solve(start: np.ndarray, level: float) -> OptimizeResult:
        width = level * len(w)

        def residual(values: np.ndarray, few: bool = False) -> np.ndarray:
            off = (render({**held, **split(values)}, few) - measured.mean) * w
            return (gaussian_filter(off, (width, width, 0)) if width else off).ravel()

        def slopes(values: np.ndarray) -> np.ndarray:
            return finite_differences(partial(residual, few=True), values, step, low, high, central)

        most = iterations if level else 3 * iterations
        return least_squares(residual, start, slopes, (low, high), ftol=1e-3, x_scale=FIRST_MOVE * step, max_nfev=most)

    for level in max((p.levels for p in fitted), key=len) if coarse else (0.0,):
        solved = solve(x, level)
        x = solved.x
    # Errors of neighbouring pixels go together, so a picture has fewer independent ones than pixels.
    slopes_per_step = solved.jac * step
    information = slopes_per_step.T @ slopes_per_step / CORRELATED_PIXELS
    scale = max(1.0, float(np.mean(solved.fun**2)))
    std = np.sqrt(scale * np.diag(np.linalg.pinv(information + 1e-9 * np.eye(len(x))))) * step
    return AppearanceFit(split(x), split(std))


def finite_differences(
    residual: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    central: np.ndarray,
) -> np.ndarray:
    """Slopes (m, d) of residuals (m,) over finite steps, central or one-sided.

    Args:
        residual: of parameters (d,).
        x: where, (d,).
        step: (d,).
        low: bounds, (d,).
        high: bounds, (d,).
        central: whether to go to both sides, (d,), where the bounds leave room.
    """
    columns, r = [], residual(x)
    for i in range(len(x)):
        up, down = x.copy(), x.copy()
        up[i], down[i] = min(x[i] + step[i], high[i]), max(x[i] - step[i], low[i])
        plus, minus = r, r
        if up[i] > x[i]:
            plus = residual(up)
        if up[i] == x[i] or (central[i] and down[i] < x[i]):
            minus = residual(down)
        width = (up[i] if plus is not r else x[i]) - (down[i] if minus is not r else x[i])
        columns.append((plus - minus) / width)
    return np.stack(columns, 1)

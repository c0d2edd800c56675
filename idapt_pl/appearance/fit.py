"""Fits knobs to a mean picture: Levenberg-Marquardt on pixels, from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from idapt_pl.appearance.knobs import Knob
from idapt_pl.appearance.pictures import Average, Settings

PIXEL = 1 / 255
ERROR = 2 * PIXEL
"""What a pixel errs by even where everything is right: rounding, edges."""
Render = Callable[[Settings, bool], np.ndarray]


@dataclass(frozen=True)
class Fit:
    """Knobs as fitted.

    Attributes:
        values: knob to its values.
        spread: knob to the standard deviations of its values, given that all that is wrong is among these knobs.
    """

    values: Settings
    spread: Settings


def weights(measured: Average, model_variance: np.ndarray) -> np.ndarray:
    """One over the standard deviation of a pixel's difference, (H, W, 3): what moves between starts counts less."""
    return 1 / np.sqrt(ERROR**2 + measured.variance + model_variance)


def fit(
    render: Render, measured: Average, model_variance: np.ndarray, start: Settings,
    held: Settings, coarse: bool = True, iterations: int = 4,
) -> Fit:  # fmt: skip
    """Turn knobs until the rendered mean picture is most like the measured one.

    Args:
        render: settings of the knobs, and whether a few starts will do, to a mean picture (H, W, 3), 0 to 1.
        measured: what it should be.
        model_variance: of the rendered mean, from the spread of its starts.
        start: the knobs to be turned, and from where.
        held: knobs that stay where they are.
        coarse: begin with blurred pictures, where one of the knobs asks for it.
        iterations: steps at each level.
    """
    knobs = list(start)
    step, low, high = (np.concatenate([getattr(k, n) for k in knobs]) for n in ("step", "low", "high"))
    central = np.concatenate([np.full(len(k.nominal), k.rank > 0) for k in knobs])
    x = np.clip(np.concatenate([start[k] for k in knobs]), low, high)
    w = weights(measured, model_variance)

    def split(values: np.ndarray) -> dict[Knob, np.ndarray]:
        ends = np.cumsum([len(k.nominal) for k in knobs])[:-1]
        return dict(zip(knobs, np.split(values, ends), strict=True))

    levels = max((k.levels for k in knobs), key=len) if coarse else (0.0,)
    for level in levels:

        def residual(values: np.ndarray, few: bool = False, level: float = level) -> np.ndarray:
            width = level * len(w)
            off = (render({**held, **split(values)}, few) - measured.mean) * w
            return (gaussian_filter(off, (width, width, 0)) if width else off).ravel()

        x, slopes, r = levenberg_marquardt(
            residual, x, step, low, high, central, iterations if level else 3 * iterations
        )
    # Errors of neighbouring pixels go together, so a picture has fewer independent ones than pixels.
    information = slopes.T @ slopes / NEIGHBOURS
    scale = max(1.0, float(np.mean(r**2)))
    spread = np.sqrt(scale * np.diag(np.linalg.pinv(information + 1e-9 * np.eye(len(x))))) * step
    return Fit(split(x), split(spread))


NEIGHBOURS = 9.0
"""Pixels whose errors go together."""


def levenberg_marquardt(
    residual: Callable[..., np.ndarray], x: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray,
    central: np.ndarray, iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Least squares within bounds. Returns the solution, slopes (m, d) per ``step``, and residuals (m,).

    ``residual`` takes parameters, and whether it may be a cheaper one, as for slopes.
    """
    r, damping = residual(x), 1e-2
    for _ in range(iterations):
        slopes = finite_differences(lambda x: residual(x, True), x, step, low, high, central)
        curvature, gradient = slopes.T @ slopes, slopes.T @ r
        for _ in range(4):
            move = np.linalg.solve(
                curvature + damping * (np.diag(np.diag(curvature)) + 1e-6 * np.eye(len(x))), -gradient
            )
            new = np.clip(x + move * step, low, high)
            r_new = residual(new)
            if better := r_new @ r_new < r @ r:
                break
            damping *= 10
        if not better:
            break
        gain, x, r, damping = 1 - (r_new @ r_new) / (r @ r), new, r_new, damping / 5
        if gain < 1e-3:
            break
    return x, slopes, r


def finite_differences(residual, x, step, low, high, central) -> np.ndarray:
    """Slopes (m, d): central ones where asked for and the bounds leave room, else one-sided ones."""
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
        columns.append((plus - minus) / width * step[i])
    return np.stack(columns, 1)

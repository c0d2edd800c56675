"""Fits of candidates: least squares over the parameters of effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.effects.candidate import Candidate
from idapt_pl.estimation.least_squares import Everywhere, LeastSquaresFit, ParameterBox, gauss_newton, one_by_one
from idapt_pl.prediction.simulator import Effects

WhitenedResidual = Callable[[Effects], np.ndarray]
"""Effects to whitened residuals, (n, rows)."""


@dataclass(frozen=True)
class CandidateFit:
    """A fit of some candidates.

    Attributes:
        x: their parameters, one array for each candidate.
        solution: the same one after the other, with loss, slopes and residuals.
    """

    x: tuple[np.ndarray, ...]
    solution: LeastSquaresFit


def effects_of(candidates: Sequence[Candidate], x: Sequence[np.ndarray]) -> Effects:
    """The effects with these parameters."""
    return tuple(c.effect(v) for c, v in zip(candidates, x, strict=True))


def split_parameters(candidates: Sequence[Candidate], x: np.ndarray) -> list[np.ndarray]:
    """Parameters one after the other, (p, ...), as one array for each candidate."""
    return np.split(x, np.cumsum([c.size for c in candidates])[:-1])


def parameter_box(candidates: Sequence[Candidate]) -> ParameterBox:
    """Scales and bounds of the candidates' parameters, one candidate after the other."""
    low, high = (np.concatenate(b) for b in zip(*(c.bounds() for c in candidates), strict=True))
    return ParameterBox(np.concatenate([c.scale for c in candidates]), low, high)


def fit_candidates(
    residual: WhitenedResidual,
    fixed: Effects,
    candidates: Sequence[Candidate],
    x: Sequence[np.ndarray],
    iterations: int,
    exact: bool = False,
    slopes: np.ndarray | None = None,
    good_enough: float = np.inf,
    cheaper: WhitenedResidual | None = None,
    everywhere: Everywhere = one_by_one,
) -> CandidateFit:
    """Fit the parameters of candidates.

    Args:
        residual: whitened residuals under some effects, (n, rows).
        fixed: effects that are not fitted.
        candidates: effects that are.
        x: where to start, one array for each candidate.
        iterations: of Gauss-Newton, at most.
        exact: measure the slopes where the fit ends, for its covariance.
        slopes: by the parameters of the first candidates, where they are known about: (n rows, q).
        good_enough: mean loss that is asked for; a fit that would not come there is left.
        cheaper: about the same residuals, to measure slopes with.
        everywhere: how residuals under several parameters are asked for.
    """

    def with_parameters(of: WhitenedResidual) -> Callable[[np.ndarray], np.ndarray]:
        return lambda v: of((*fixed, *effects_of(candidates, split_parameters(candidates, v))))

    at, about = with_parameters(residual), None if cheaper is None else with_parameters(cheaper)
    start = np.concatenate([np.asarray(v, float) for v in x])
    fit = gauss_newton(at, start, parameter_box(candidates), iterations, exact, slopes, good_enough, about, everywhere)
    return CandidateFit(tuple(split_parameters(candidates, fit.x)), fit)

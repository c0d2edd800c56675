"""What terms of a law would do to short forecasts, linearly: no simulation for each."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from idapt_pl.diagnosis.laws.terms import JointSizes, Term, dictionary
from idapt_pl.diagnosis.rounds.screening import ScoreTest

REFINEMENT_TRIALS = 40
"""Values of the inner parameters that a refinement tries."""

FLAT = 1e-6
"""Share of a column that must be left after what was accepted is taken out of it."""


@dataclass(frozen=True, eq=False)
class TermColumns:
    """Some terms and what they do to the forecasts.

    Attributes:
        terms: summed.
        columns: d residual / d amplitude, (rows, amplitudes), orthogonal to what is accepted.
        rms: of the function behind each amplitude, (amplitudes,).
    """

    terms: tuple[Term, ...]
    columns: np.ndarray
    rms: np.ndarray

    def beside(self, other: TermColumns) -> TermColumns:
        """The sum of both."""
        columns, rms = (np.concatenate(pair, -1) for pair in ((self.columns, other.columns), (self.rms, other.rms)))
        return TermColumns((*self.terms, *other.terms), columns, rms)


@dataclass(frozen=True, eq=False)
class JointForecasts:
    """Forecasts as they depend on a force on one joint.

    Attributes:
        sizes: of the joint.
        torque: that would stop it within a forecast.
        response: d whitened residual / d force in a control step, (n, rows, steps).
        values: a formula without coefficients to its values in every control step, (n, steps).
        test: what is left to explain, and what is accepted.
    """

    sizes: JointSizes
    torque: float
    response: np.ndarray
    values: Callable[[str], np.ndarray]
    test: ScoreTest

    def columns(self, terms: Sequence[Term]) -> TermColumns | None:
        """What terms do; None where one does nothing that accepted effects do not do."""
        values = [self.values(text) for term in terms for text in term.columns()]
        plain = np.stack([np.einsum("nrk,nk->nr", self.response, x).ravel() for x in values], 1)
        left = self.test.clear(plain)
        if not (np.linalg.norm(left, axis=0) > FLAT * np.linalg.norm(plain, axis=0) + 1e-12).all():
            return None
        return TermColumns(tuple(terms), left, np.sqrt(np.mean(np.square(values), (1, 2))) + 1e-12)

    @functools.cached_property
    def single_terms(self) -> list[TermColumns]:
        """What each term of the dictionary does, of those that do something of their own."""
        return [at for term in dictionary(self.sizes) if (at := self.columns([term]))]

    def score(self, at: TermColumns) -> float:
        """Squared residual that the best amplitudes remove, in units of what noise leaves."""
        return regress(at.columns, self.test.left)[1] / self.test.variance

    def refined(self, at: TermColumns, span: Callable[[Term], list[tuple[float, float]]]) -> TermColumns:
        """With better inner parameters, inside their spans: the simplex method on what the best amplitudes leave."""
        inner = np.array([value for t in at.terms for value in t.inner])
        if not len(inner):
            return at
        bounds = [b for t in at.terms for b in span(t)]
        best, most = at, self.score(at)

        def lost(x: np.ndarray) -> float:
            nonlocal best, most
            tried = self.columns(with_inner(at.terms, x))
            gain = self.score(tried) if tried else 0.0
            if tried and gain > most:
                best, most = tried, gain
            return -gain

        first = np.diag(0.3 * np.abs(inner) + 1e-6)
        simplex = np.clip(np.concatenate([inner[None], inner + first]), *np.array(bounds).T)
        options = {"maxfev": REFINEMENT_TRIALS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 0.5}
        minimize(lost, inner, method="Nelder-Mead", bounds=bounds, options=options)
        return best


def with_inner(terms: Sequence[Term], inner: np.ndarray) -> list[Term]:
    """Terms with other inner parameters, one after the other."""
    values = iter(inner.tolist())
    return [Term(t.text, t.basis, tuple(next(values) for _ in t.inner), t.per) for t in terms]


def regress(X: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, float]:
    """Least-squares amplitudes that make ``left`` + X x small, and how much squared error they remove.

    A column of zeros, as of a term that never acts, has amplitude 0.
    """
    H, g = X.T @ X, X.T @ left
    scale = np.where(np.diag(H) > 0, np.sqrt(np.diag(H)), 1.0)
    x = -np.linalg.solve(H / np.outer(scale, scale) + 1e-6 * np.eye(len(H)), g / scale) / scale
    return x, float(-2 * x @ g - x @ H @ x)

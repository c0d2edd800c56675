"""A law as a candidate: terms of the dictionary on one joint, whose parameters are fitted by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.laws.terms import OF_THE_LIBRARY, JointSizes, Term, term_units, write_law
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.expression import COEFFICIENTS, parse_expression
from idapt_pl.effects.learned import LearnedForce

WIDEST = 20.0
"""By how much an inner parameter may leave its start, as a factor."""


@dataclass(frozen=True)
class LawCandidate(Candidate):
    """Attributes beside those of a candidate: the ``terms`` of the sum, and whether the joint is a ``hinge``."""

    terms: tuple[Term, ...] = ()
    hinge: bool = True

    @property
    def formula(self) -> str:
        """With letters for coefficients."""
        return str(dict(self.fixed)["expression"])

    @property
    def label(self) -> str:
        return f"{self.kind.name}({self.target}: {self.formula})"

    @property
    def in_model(self) -> tuple[float | None, ...]:
        """No amplitude is in the model, and where or how a law acts is nowhere: its fit began at a guess."""
        at = amplitude_places(self.terms)
        return tuple(0.0 if k in at else None for k in range(self.size))

    @property
    def known(self) -> bool:
        """Whether the library has such an effect, which was tried and refused before."""
        return len(self.terms) == 1 and self.of_known_parts

    @property
    def of_known_parts(self) -> bool:
        """Whether the library has all of its terms."""
        return all(t.text in OF_THE_LIBRARY for t in self.terms)

    def units(self) -> list[str]:
        return [unit for term in self.terms for unit in term_units(term, self.hinge)]

    def change(self, x: np.ndarray) -> float:
        """How strong it is, in units of what would stop the joint within a forecast."""
        at = amplitude_places(self.terms)
        return float(np.max(np.abs(np.asarray(x)[at]) / np.array(self.scale)[at]))

    @property
    def depends(self) -> frozenset[str]:
        """Signals that it depends on."""
        return parse_expression(self.formula).signals


def amplitude_places(terms: Sequence[Term]) -> np.ndarray:
    """Which of the parameters are amplitudes."""
    kinds = [k for t in terms for k in (True,) * t.amplitudes + (False,) * len(t.inner)]
    return np.flatnonzero(kinds)


MOST = 1e9
"""What a coefficient of a law can be, either sign."""


def law_candidate(
    sizes: JointSizes, terms: Sequence[Term], amplitudes: np.ndarray, typical: np.ndarray
) -> tuple[LawCandidate, np.ndarray]:
    """A candidate on a joint, and where its fit starts.

    Args:
        sizes: of the joint.
        terms: to sum.
        amplitudes: first guesses, one after the other.
        typical: noticeable ones, as many.
    """
    start, scale, span = [], [], []
    guesses = iter(zip(amplitudes, typical, strict=True))
    for term in terms:
        for _ in range(term.amplitudes):
            guess, usual = next(guesses)
            start.append(float(guess))
            scale.append(float(usual))
            most = min(1e4 * float(usual), MOST)
            span.append((-most, most))
        for value, per in zip(term.inner, term.per, strict=True):
            start.append(value)
            scale.append(inner_scale(value, per, sizes, term))
            span.append(inner_span(value, per, sizes, term))
    at = amplitude_places(terms)
    nominal = np.array(start)
    nominal[at] = 0.0
    candidate = LawCandidate(
        LearnedForce,
        sizes.name,
        tuple(COEFFICIENTS[: len(start)]),
        tuple(nominal.tolist()),
        tuple(scale),
        fixed=(("expression", write_law(terms)),),
        span=tuple(span),
        terms=tuple(terms),
        hinge=sizes.hinge,
    )
    return candidate, np.array(start)


def is_place(value: float, per: str, term: Term) -> bool:
    """Whether an inner parameter is a position where something is, and not a width."""
    return (
        per == "q"
        and any(form in term.text for form in ("(q - P)", "(P - q)", "positive(q - P)"))
        and value == term.inner[0]
    )


def inner_scale(value: float, per: str, sizes: JointSizes, term: Term) -> float:
    """A noticeable change of an inner parameter."""
    if is_place(value, per, term):
        return 0.1 * sizes.spread
    if per == "/q":
        return 0.5 / sizes.spread
    return 0.3 * abs(value)


def inner_span(value: float, per: str, sizes: JointSizes, term: Term) -> tuple[float, float]:
    """Bounds of an inner parameter."""
    if is_place(value, per, term):
        return float(sizes.places[0] - 0.2 * sizes.spread), float(sizes.places[-1] + 0.2 * sizes.spread)
    if per == "/q":
        return max(0.2 / sizes.spread, value - 3 / sizes.spread), value + 3 / sizes.spread
    low, high = sorted((value / WIDEST, value * WIDEST))
    return low, high

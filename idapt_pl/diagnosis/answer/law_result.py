"""What a search for laws says, as values; :meth:`LawReport.to_dict` is ``laws`` in ``report.json``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from idapt_pl.diagnosis.answer.result import ParameterEstimate
from idapt_pl.diagnosis.answer.summary import estimate_of, significant
from idapt_pl.diagnosis.candidates.listing import typical_sizes
from idapt_pl.diagnosis.laws.candidate import LawCandidate
from idapt_pl.diagnosis.laws.places import ResidualPlace
from idapt_pl.diagnosis.laws.search import LawSearch, laws_of
from idapt_pl.diagnosis.rounds.force_response import measured_signals_of, term_values
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects.wording import format_number

NEGLIGIBLE = 0.01
"""Share of the usual force at a joint below which the largest force of a law is said with the details alone."""

MOST_OTHERS = 4
"""Other formulas that a report lists."""


@dataclass(frozen=True)
class LawFinding:
    """A law that was found.

    Attributes:
        joint: on which the force acts.
        expression: the formula, with letters for coefficients.
        formula: the same with numbers, for a reader.
        unit: of the force.
        parameters: estimates of the coefficients by their letters.
        depends: signals that it depends on; ``history`` where it remembers.
        share: of what was above the noise floor before it that it removes, held out, with what it makes needless gone.
        others: formulas that were fitted too, with the error that they leave.
        largest: force that it comes to in the recordings, in ``unit``.
        largest_share: the same, as a share of the motor's usual (rms) one there; of a joint without a motor, of what
            would stop it within a forecast.
    """

    joint: str
    expression: str
    formula: str
    unit: str
    parameters: Mapping[str, ParameterEstimate]
    depends: tuple[str, ...]
    share: float
    others: Sequence[tuple[str, str, float]]
    largest: float
    largest_share: float

    @property
    def negligible(self) -> bool:
        """Whether it is too weak to be worth a headline, however surely it is there."""
        return self.largest_share < NEGLIGIBLE

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "joint": self.joint,
            "expression": self.expression,
            "formula": self.formula,
            "unit": self.unit,
            "coefficients": {k: p.to_dict() for k, p in self.parameters.items()},
            "depends_on": list(self.depends),
            "removed_share": self.share,
            "largest_force": self.largest,
            "largest_share_of_usual": self.largest_share,
            "others": [{"joint": j, "expression": text, "error": error} for j, text, error in self.others],
        }


@dataclass(frozen=True)
class NetworkFinding:
    """A black box that stands for a force that no law says.

    Attributes:
        joint: on which it acts.
        inputs: signals that it sees.
        share: of what was above the noise floor that it removes, held out.
    """

    joint: str
    inputs: tuple[str, ...]
    share: float

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {"joint": self.joint, "inputs": list(self.inputs), "removed_share": self.share, "black_box": True}


@dataclass(frozen=True)
class LawReport:
    """What a search for laws came to.

    Attributes:
        before: error before it, on held-out episodes, in standard deviations.
        after: with laws, or the network.
        found: the laws.
        network: what stands in where there is no law; None where there is one, or nothing helps.
        needless: effects found before that the laws make needless, as ``effect(target)``.
        where: forces and sensors that explain most of the residual, by regression.
        sensor: name of the joint whose sensor is to blame rather than a force; empty if none is.
        seconds: that the search took.
    """

    before: float
    after: float
    found: Sequence[LawFinding]
    network: NetworkFinding | None
    needless: Sequence[str]
    where: Sequence[ResidualPlace]
    sensor: str
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "error_before": self.before,
            "error_after": self.after,
            "found": [f.to_dict() for f in self.found],
            "residual_network": None if self.network is None else self.network.to_dict(),
            "makes_needless": list(self.needless),
            "where": [p.to_dict() for p in self.where],
            "sensor": self.sensor,
            "seconds": self.seconds,
        }


def report_laws(context: SearchContext, search: LawSearch, seconds: float) -> LawReport:
    """The outcome of a search for laws; intervals have been measured."""
    before, after = (held_out_error(context, s, search.state) for s in (search.before, search.state))
    kept = {a.round for a in search.state.accepted}
    return LawReport(
        before=round(before, 4),
        after=round(after, 4),
        found=[finding(context, search, a) for a in laws_of(search.state)],
        network=None if search.network is None else NetworkFinding(*search.network),
        needless=[a.candidate.label for a in search.before.accepted if a.round not in kept],
        where=search.places[:6],
        sensor=search.sensor,
        seconds=round(seconds, 2),
    )


def held_out_error(context: SearchContext, state: SearchState, judge: SearchState) -> float:
    """Error of a state on the held-out windows of another one."""
    return float(context.loss(judge.windows.held_out, state.effects).mean()) ** 0.5


def finding(context: SearchContext, search: LawSearch, a: AcceptedEffect) -> LawFinding:
    """One law."""
    estimate, candidate = estimate_of(context, search.state, a), a.candidate
    assert isinstance(candidate, LawCandidate), "laws are made of law candidates"
    without = held_out_error(context, search.state.without(a), search.state)
    with_it = held_out_error(context, search.state, search.state)
    others = search.others.get(candidate.label, [])[:MOST_OTHERS]
    largest, usual = largest_and_usual_force(context, search.state, a)
    return LawFinding(
        joint=candidate.target,
        expression=candidate.formula,
        formula=formula_in_numbers(candidate.formula, {k: float(p.estimate) for k, p in estimate.parameters.items()}),
        unit="N·m" if candidate.hinge else "N",
        parameters=estimate.parameters,
        depends=depends_on(candidate),
        share=round((without**2 - with_it**2) / max(without**2 - 1.0, 1e-9), 4),
        others=[(f.candidate.target, f.candidate.formula, round(float(f.losses.mean()) ** 0.5, 4)) for f in others],
        largest=significant(largest, 3),
        largest_share=significant(largest / usual, 3),
    )


def largest_and_usual_force(context: SearchContext, state: SearchState, a: AcceptedEffect) -> tuple[float, float]:
    """The largest force of a law in the fitted windows, and what acts on its joint there usually, N·m or N."""
    model, windows, candidate = context.sim.model, state.windows.fit.windows, a.candidate
    assert isinstance(candidate, LawCandidate), "it is of a law"
    (seen,) = measured_signals_of(context, state.effects, windows, [model.joint(candidate.target).id])
    values = dict(zip(candidate.names, a.x, strict=True))
    formula = re.sub(r"\b[a-h]\b", lambda letter: f"({values[letter[0]]:.9g})", candidate.formula)
    motor = float(np.sqrt(np.square(seen.now["motor"]).mean()))
    torque = typical_sizes(model, list(context.sim.data), context.horizon).torque
    usual = motor or float(torque[model.joint(candidate.target).dofadr[0]])
    return float(np.abs(term_values(context, state.effects, windows, seen, formula)).max()), max(usual, 1e-12)


def depends_on(candidate: LawCandidate) -> tuple[str, ...]:
    """Signals by name, and ``history`` where a law remembers."""
    remembers = "lowpass" in candidate.formula or "hysteresis" in candidate.formula
    return (*sorted(candidate.depends), *(["history"] * remembers))


def formula_in_numbers(expression: str, values: Mapping[str, float]) -> str:
    """A formula for a reader: ``-0.35·abs(load)·tanh(v/0.03)``."""

    def number(match: re.Match[str]) -> str:
        value = values[match[0]]
        text = format_number(value)
        return f"({text})" if value < 0 and match.start() > 0 else text

    written = re.sub(r"\b[a-h]\b", number, expression).replace("**2", "²").replace("**3", "³").replace("*", "·")
    return re.sub(r"\+ \(-([^()]*)\)", r"- \1", written)

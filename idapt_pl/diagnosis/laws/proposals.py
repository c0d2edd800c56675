"""Which laws might explain what is left: sparse regression of forecasts' residuals on what terms would do to them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from idapt_pl.diagnosis.candidates.listing import typical_sizes
from idapt_pl.diagnosis.laws.candidate import LawCandidate, inner_span, law_candidate
from idapt_pl.diagnosis.laws.forecasts import JointForecasts, TermColumns, regress
from idapt_pl.diagnosis.laws.terms import JointSizes, Term, joint_sizes
from idapt_pl.diagnosis.rounds.force_response import PUSH, force_response, measured_signals_of, term_values
from idapt_pl.diagnosis.rounds.screening import ScoreTest
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.effects.candidate import mechanical_joints
from idapt_pl.effects.expression import COEFFICIENTS
from idapt_pl.estimation.least_squares import project_out

SINGLES, FIRST, SECOND = 6, 3, 3
"""Shapes of one term that are refined on a joint; those of them that a second term is sought for; how many each."""

COST = 3.0
"""Score that a parameter must be worth, in a ranking of proposals."""

WORTH_A_LOOK = 0.2
"""Share of the best joint's score that another joint must come to, to be looked at closely."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """A law that regression proposes.

    Attributes:
        candidate: with its parameters.
        start: of a fit, (p,).
        score: squared residual that it removes by regression, in units of what noise leaves.
    """

    candidate: LawCandidate
    start: np.ndarray
    score: float

    @property
    def merit(self) -> float:
        """Score, less what as many parameters cost."""
        return self.score - COST * self.candidate.size


def propose_laws(forecasts: Sequence[JointForecasts], most: int) -> list[Proposal]:
    """The best laws of one term and of two, half of each; best first."""
    singles = [best_singles(f) for f in forecasts]
    tops = [f.score(s[0]) if s else 0.0 for f, s in zip(forecasts, singles, strict=True)]
    found: list[Proposal] = []
    for f, ranked, top in zip(forecasts, singles, tops, strict=True):
        if ranked and top > WORTH_A_LOOK * max(tops):
            refined = [f.refined(at, partial(spans, f.sizes)) for at in ranked[:SINGLES]]
            pairs = [f.refined(at, partial(spans, f.sizes)) for at in best_pairs(f, by_merit(f, refined)[:FIRST])]
            found += [proposal(f, at) for at in (*refined, *pairs)]
    found.sort(key=lambda p: -p.merit)
    one = [p for p in found if len(p.candidate.terms) == 1][: most // 2]
    two = [p for p in found if len(p.candidate.terms) > 1][: most - len(one)]
    return sorted(one + two, key=lambda p: -p.merit)


def joint_forecasts(context: SearchContext, state: SearchState) -> list[JointForecasts]:
    """How the forecasts of the fitted windows depend on forces, joint by joint."""
    sim, split = context.sim, state.windows.fit
    joints = mechanical_joints(sim.model)
    if not joints:
        return []
    test = ScoreTest(context, state, split)
    torque = typical_sizes(sim.model, list(sim.data), context.horizon).torque
    dofs = np.array([v for _, v, _ in joints])
    response = force_response(context, state, split, dofs, PUSH * torque[dofs])
    seen = measured_signals_of(context, state.effects, split.windows, [j for j, _, _ in joints])
    return [
        JointForecasts(
            sizes_of(context, j, v),
            float(torque[v]),
            response[:, :, k],
            partial(term_values, context, state.effects, split.windows, seen[k]),
            test,
        )
        for k, (j, v, _) in enumerate(joints)
    ]


def sizes_of(context: SearchContext, joint: int, dof: int) -> JointSizes:
    """What a joint does in the recordings."""
    sim = context.sim
    qpos = np.concatenate([r.qpos[:, sim.model.jnt_qposadr[joint]] for r in sim.data])
    qvel = np.concatenate([r.qvel[:, dof] for r in sim.data])
    episode = float(np.median([r.time[-1] - r.time[0] for r in sim.data]))
    return joint_sizes(sim.model, joint, qpos, qvel, episode, sim.control_period)


def merit(f: JointForecasts, at: TermColumns) -> float:
    """Score, less what as many parameters cost."""
    return f.score(at) - COST * sum(t.size for t in at.terms)


def by_merit(f: JointForecasts, found: Iterable[TermColumns]) -> list[TermColumns]:
    """Best first."""
    return sorted(found, key=lambda at: -merit(f, at))


def best_singles(f: JointForecasts) -> list[TermColumns]:
    """Every shape with one term, at the best of its starts; best first."""
    best: dict[str, TermColumns] = {}
    for at in by_merit(f, f.single_terms):
        best.setdefault(at.terms[0].text, at)
    return list(best.values())


def best_pairs(f: JointForecasts, firsts: Sequence[TermColumns]) -> list[TermColumns]:
    """The best second terms beside some first ones."""
    found: dict[frozenset[str], TermColumns] = {}
    for first in firsts:
        Q = np.linalg.qr(first.columns)[0]
        rest = project_out(Q, f.test.left[:, None])[:, 0]
        gains = [(regress(project_out(Q, at.columns), rest)[1], at) for at in f.single_terms]
        shapes: dict[str, TermColumns] = {}
        for _, at in sorted(gains, key=lambda g: -g[0]):
            if first.terms[0].size + at.terms[0].size <= len(COEFFICIENTS):
                shapes.setdefault(at.terms[0].text, at)
        for at in list(shapes.values())[:SECOND]:
            found.setdefault(frozenset((first.terms[0].text, at.terms[0].text)), first.beside(at))
    return list(found.values())


def spans(sizes: JointSizes, term: Term) -> list[tuple[float, float]]:
    """Bounds of a term's inner parameters."""
    return [inner_span(value, per, sizes, term) for value, per in zip(term.inner, term.per, strict=True)]


def proposal(f: JointForecasts, at: TermColumns) -> Proposal:
    """A law as a candidate, with the best amplitudes."""
    x, gain = regress(at.columns, f.test.left)
    typical = f.torque / at.rms
    x = np.clip(x, -100 * typical, 100 * typical)
    return Proposal(*law_candidate(f.sizes, at.terms, x, typical), gain / f.test.variance)

"""Which laws might explain what is left: sparse regression of forecasts' residuals on what terms would do to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.candidates import typical_sizes
from idapt_pl.diagnosis.context import SearchContext
from idapt_pl.diagnosis.law_candidate import LawCandidate, law_candidate
from idapt_pl.diagnosis.law_response import PUSH, force_response, measured_signals_of, term_values
from idapt_pl.diagnosis.law_terms import JointSizes, Term, dictionary, joint_sizes
from idapt_pl.diagnosis.screening import ScoreTest
from idapt_pl.diagnosis.search_state import SearchState
from idapt_pl.effects.candidate import mechanical_joints
from idapt_pl.estimation.least_squares import project_out

FIRST_TERMS = 12
"""Single terms that a second one is looked for beside."""

COST = 3.0
"""Score that a parameter must be worth, in a ranking of proposals."""

FLAT = 1e-9
"""Share of a column that must be left after what was accepted is taken out of it."""


@dataclass(frozen=True, eq=False)
class ColumnsOfTerm:
    """What a term does to the forecasts.

    Attributes:
        term: the term.
        columns: d residual / d amplitude, (rows, amplitudes), orthogonal to what is accepted.
        rms: of the function behind each amplitude, (amplitudes,).
    """

    term: Term
    columns: np.ndarray
    rms: np.ndarray


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

    @property
    def shape(self) -> tuple[str, str]:
        """Joint and formula: proposals with the same differ in where they start."""
        return self.candidate.target, self.candidate.formula


def propose_laws(context: SearchContext, state: SearchState, most: int) -> list[Proposal]:
    """The best laws of one term and of two, of every shape the best start; best first."""
    sim, split = context.sim, state.windows.fit
    test = ScoreTest(context, state, split, context.whitened)
    typical = typical_sizes(sim.model, list(sim.data), context.horizon)
    joints = mechanical_joints(sim.model)
    if not joints:
        return []
    dofs = np.array([v for _, v, _ in joints])
    response = force_response(context, state, split, dofs, PUSH * typical.torque[dofs])
    seen = measured_signals_of(context, split.windows, [j for j, _, _ in joints])
    found: list[Proposal] = []
    for k, (j, v, _) in enumerate(joints):
        sizes = sizes_of(context, j, v)
        tried = []
        for term in dictionary(sizes):
            values = [term_values(context, split.windows, seen[k], text) for text in term.columns()]
            columns = np.stack([np.einsum("nrk,nk->nr", response[:, :, k], x).ravel() for x in values], 1)
            left = test.clear(columns)
            if (np.linalg.norm(left, axis=0) > FLAT * np.linalg.norm(columns, axis=0) + 1e-300).all():
                rms = np.sqrt(np.mean(np.square(values), (1, 2))) + 1e-12
                tried.append(ColumnsOfTerm(term, left, rms))
        found += of_one_joint(sizes, tried, test, float(typical.torque[v]))
    return best_of_each_shape(found, most)


def sizes_of(context: SearchContext, joint: int, dof: int) -> JointSizes:
    """What a joint does in the recordings."""
    sim = context.sim
    qpos = np.concatenate([r.qpos[:, sim.model.jnt_qposadr[joint]] for r in sim.data])
    qvel = np.concatenate([r.qvel[:, dof] for r in sim.data])
    episode = float(np.median([r.time[-1] - r.time[0] for r in sim.data]))
    return joint_sizes(sim.model, joint, qpos, qvel, episode, sim.control_period)


def of_one_joint(sizes: JointSizes, tried: Sequence[ColumnsOfTerm], test: ScoreTest, torque: float) -> list[Proposal]:
    """Proposals with one term and with two on a joint."""
    left = test.left

    def proposal(chosen: Sequence[ColumnsOfTerm]) -> Proposal:
        X = np.concatenate([c.columns for c in chosen], 1)
        x, gain = regress(X, left)
        typical = torque / np.concatenate([c.rms for c in chosen])
        x = np.clip(x, -100 * typical, 100 * typical)
        return Proposal(*law_candidate(sizes, [c.term for c in chosen], x, typical), gain / test.variance)

    singles = sorted(((proposal([c]), c) for c in tried), key=lambda p: -p[0].merit)
    pairs = []
    for _, first in singles[:FIRST_TERMS]:
        Q = np.linalg.qr(first.columns)[0]
        rest = project_out(Q, left[:, None])[:, 0]
        others = [(regress(project_out(Q, c.columns), rest)[1], c) for c in tried if c is not first]
        best = sorted(others, key=lambda o: -o[0])[:4]
        pairs += [proposal([first, c]) for gain, c in best if first.term.size + c.term.size <= 8]
    return [p for p, _ in singles] + pairs


def regress(X: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, float]:
    """Least-squares amplitudes that make ``left`` + X x small, and how much squared error they remove."""
    H, g = X.T @ X, X.T @ left
    scale = np.sqrt(np.diag(H)) + 1e-300
    x = -np.linalg.solve(H / np.outer(scale, scale) + 1e-6 * np.eye(len(H)), g / scale) / scale
    return x, float(-2 * x @ g - x @ H @ x)


def best_of_each_shape(found: Sequence[Proposal], most: int) -> list[Proposal]:
    """The best start of each formula; half of the places are for laws of one term."""
    best: dict[tuple[str, str], Proposal] = {}
    for p in sorted(found, key=lambda p: -p.merit):
        best.setdefault(p.shape, p)
    singles = [p for p in best.values() if len(p.candidate.terms) == 1][: most // 2]
    pairs = [p for p in best.values() if len(p.candidate.terms) > 1][: most - len(singles)]
    return sorted(singles + pairs, key=lambda p: -p.merit)

"""The search for a law of force where the library of effects leaves something unexplained.

Regression of what is left proposes formulas, simulation fits them, and held-out episodes decide, as of any effect.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.laws.candidate import LawCandidate
from idapt_pl.diagnosis.laws.forecasts import JointForecasts
from idapt_pl.diagnosis.laws.network import fit_network
from idapt_pl.diagnosis.laws.places import ResidualPlace, blamed_sensor, residual_places
from idapt_pl.diagnosis.laws.proposals import Proposal, joint_forecasts, propose_laws
from idapt_pl.diagnosis.rounds.gates import LEFT_OVER
from idapt_pl.diagnosis.rounds.numerics import retest_numerics
from idapt_pl.diagnosis.rounds.revision import eliminate_needless
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import (
    AcceptedEffect,
    SearchState,
    refit_accepted,
    renew,
    slopes_of_accepted,
)
from idapt_pl.estimation.intervals import paired_gain

log = logging.getLogger(__name__)

MOST_LAWS = 2
"""Laws that are looked for, one after the other."""

PROPOSED, FITTED = 8, 3
"""Laws that regression proposes; of these, fitted on more windows and judged on held-out episodes."""

LEAST_SHARE, LEAST_OF_ALL = 0.3, 0.1
"""Shares of what is above the noise floor, and of the whole held-out loss, that a law must remove."""

NETWORKS = 2
"""Joints on which a black box is tried."""

Estimates = tuple[np.ndarray, ...]
"""Parameters of what was accepted before, then of one more."""

PRICE = 0.03
"""Share of the best gain that every further parameter must be worth."""


@dataclass(frozen=True, eq=False)
class FittedLaw:
    """A law that was fitted by simulation and judged.

    Attributes:
        proposal: where it came from.
        x: parameters of what was accepted before, then its own.
        losses: of each held-out window with it, (n,).
        gain, gain_error: of the held-out loss.
    """

    proposal: Proposal
    x: tuple[np.ndarray, ...]
    losses: np.ndarray
    gain: float
    gain_error: float

    @property
    def candidate(self) -> LawCandidate:
        """The law."""
        return self.proposal.candidate

    def cost(self, best: float) -> float:
        """Held-out loss, and what its parameters cost; ``best``: the best gain of all."""
        return float(self.losses.mean()) + PRICE * best * self.candidate.size


@dataclass(frozen=True, eq=False)
class LawSearch:
    """Outcome of a search for laws.

    Attributes:
        state: with the laws as accepted effects; needless effects are left out.
        before: the state that the search began with.
        others: of each law, the best that were refused for it.
        places: where the residual lived before.
        sensor: the joint whose sensor is to blame, if one is.
        network: joint, inputs and share of the removable error of what stands in for a law.
        hint: the first law, if it is made of effects of the library.
    """

    state: SearchState
    before: SearchState
    others: dict[str, list[FittedLaw]]
    places: Sequence[ResidualPlace] = ()
    sensor: str = ""
    network: tuple[str, tuple[str, ...], float] | None = None
    hint: LawCandidate | None = None

    @property
    def laws(self) -> list[AcceptedEffect]:
        """What was found."""
        return laws_of(self.state)


def laws_of(state: SearchState) -> list[AcceptedEffect]:
    """Laws among the accepted effects."""
    return [a for a in state.accepted if isinstance(a.candidate, LawCandidate)]


def search_laws(context: SearchContext, state: SearchState) -> LawSearch | None:
    """Look for laws on top of a finished search; the accepted effects are refitted with them.

    None where too little is left to look for, or nothing could have a law.
    """
    plays = (
        context.sim.compile(state.effects).nv > context.sim.model.nv
    )  # where in its play a joint is, nothing measures
    if plays or not explains_too_little(context, state):
        return None
    context.progress("where is the rest?", 0.91)
    log.info("looking for a law of force, as effects leave much unexplained; it may take as long as they did")
    forecasts = joint_forecasts(context, state)
    if not forecasts:
        return None
    places = residual_places(context, state, forecasts)
    if sensor := blamed_sensor(places):
        return LawSearch(state, state, {}, places, sensor.joint)
    before, others, hint = state, dict[str, list[FittedLaw]](), None
    for k in range(MOST_LAWS):
        context.progress(f"looking for a law {k + 1}", 0.92 + 0.01 * k)
        found = one_law(context, state, forecasts if k == 0 else joint_forecasts(context, state))
        if found is None:
            break
        law = laws_of(found[0])[-1].candidate
        assert isinstance(law, LawCandidate), "it was found last"
        hint = law if k == 0 and law.of_known_parts else hint
        if law.known:
            log.info("what is left looks like %s, which was refused as an effect", law.label)
            if not laws_of(state):
                return LawSearch(state, before, others, places, hint=hint)
            break
        state, others[laws_of(found[0])[-1].candidate.label] = found
        state = retest_numerics(context, refit_accepted(context, renew(context, state)))
        if not explains_too_little(context, state):
            break
    if laws_of(state):
        state = eliminate_needless(context, state)
    if laws_of(state):
        return LawSearch(state, before, others, places, hint=hint)
    return with_network(context, LawSearch(before, before, others, places), forecasts)


def with_network(context: SearchContext, search: LawSearch, forecasts: Sequence[JointForecasts]) -> LawSearch:
    """The search with a black box in place of a law, on the joint where it does best, if it surely helps."""
    context.progress("a black box for the rest", 0.94)
    state, best = search.before, [p.joint for p in search.places if p.kind == "force"][:NETWORKS]
    fits = [fit_network(context, state, f) for f in forecasts if f.sizes.name in best]
    for fit in sorted(fits, key=lambda fit: fit.left)[:1]:
        now = context.loss(state.windows.held_out, state.effects)
        after = context.loss(state.windows.held_out, (*state.effects, fit.effect))
        gain, error = paired_gain(now, after, state.windows.held_out.windows.episode)
        if worth_it(context, gain, error, now):
            share = gain / max(float(now.mean()) - 1.0, 1e-9)
            fixed = (*state.fixed, fit.effect)
            box = fit.effect.target, tuple(fit.effect.inputs.split()), round(share, 4)
            return replace(search, state=replace(state, fixed=fixed), network=box)
    return search


def explains_too_little(context: SearchContext, state: SearchState) -> bool:
    """Whether so much is left that a law is worth looking for."""
    return float(context.loss(state.windows.held_out, state.effects).mean()) > LEFT_OVER


def one_law(
    context: SearchContext, state: SearchState, forecasts: Sequence[JointForecasts]
) -> tuple[SearchState, list[FittedLaw]] | None:
    """The state with the best law, not refitted, and those refused for it; None where none is good enough."""
    now = context.loss(state.windows.held_out, state.effects)
    fitted = fit_laws(context, state, propose_laws(forecasts, PROPOSED), now)
    passed = [f for f in fitted if worth_it(context, f.gain, f.gain_error, now)]
    if not passed:
        return None
    best_gain = max(f.gain for f in passed)
    best = min(passed, key=lambda f: f.cost(best_gain))
    round = 1 + max((a.round for a in state.accepted), default=-1)
    log.info("law %s: %.3g -> %.3g", best.candidate.label, now.mean(), best.losses.mean())
    accepted = AcceptedEffect(round, best.candidate, best.x[-1])
    others = sorted((f for f in fitted if f is not best), key=lambda f: f.losses.mean())
    state = state.with_estimates(best.x[:-1])
    return replace(state, accepted=(*state.accepted, accepted)), others


def worth_it(context: SearchContext, gain: float, error: float, now: np.ndarray) -> bool:
    """Whether a held-out gain is as sure as that of any effect, and large; ``now``: losses without it, (n,)."""
    level = float(now.mean())
    large = gain > max(LEAST_SHARE * max(level - 1.0, 0.0), LEAST_OF_ALL * level)
    return large and gain - context.settings.sureness * error > 0


def fit_laws(
    context: SearchContext, state: SearchState, proposals: Sequence[Proposal], now: np.ndarray
) -> list[FittedLaw]:
    """Fit proposals by simulation on few windows, the best on all, and judge these; ``now``: losses without, (n,)."""
    windows, each = state.windows, context.sim.side_by_side.map
    few = slopes_of_accepted(context, state, windows.scout)

    def begin(p: Proposal) -> tuple[float, Estimates, Proposal]:
        candidates, start = [*state.candidates, p.candidate], [*state.estimates, p.start]
        fit = context.fit(windows.scout, state.fixed, candidates, start, 3, slopes=few)
        return fit.solution.loss * (1 + 0.01 * p.candidate.size), fit.x, p

    rough = sorted(each(begin, proposals), key=lambda r: r[0])[:FITTED]
    more = slopes_of_accepted(context, state, windows.screen)

    def judge(begun: tuple[float, Estimates, Proposal]) -> FittedLaw:
        _, x, p = begun
        candidates = [*state.candidates, p.candidate]
        x = context.fit(windows.screen, state.fixed, candidates, x, 5, slopes=more).x
        losses = context.loss(windows.held_out, (*state.fixed, *effects_of(candidates, x)))
        return FittedLaw(p, x, losses, *paired_gain(now, losses, windows.held_out.windows.episode))

    fitted = each(judge, rough)
    for f in fitted:
        log.info("tried %s: %.3g", f.candidate.label, f.losses.mean())
    return fitted

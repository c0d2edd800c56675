"""Where a search stands: a model in the making, and the windows it is fitted to and judged on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.diagnosis.candidates.fit import effects_of, parameter_box, split_parameters
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_windows import ModelStructure, SearchWindows, whiten_windows
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.estimation.least_squares import jacobian
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import WhitenedWindows


@dataclass(frozen=True, eq=False)
class AcceptedEffect:
    """An accepted effect, with its estimate.

    Attributes:
        round: in which it was accepted, which tells it from the others even when a rival takes its place.
        candidate: the effect.
        x: its parameters, (p,).
        equivalent: trials that do as well on these data.
        rivals: the best that were refused for it.
        interval: 95 %, (p, 2); None before it is measured.
        implausible: why no machine has it, where nothing else explains the recordings; else empty.
        gain: mean held-out loss without it minus with it, when it was accepted; infinite where that is not known.
    """

    round: int
    candidate: Candidate
    x: np.ndarray
    equivalent: tuple[Trial, ...] = ()
    rivals: tuple[Trial, ...] = ()
    interval: np.ndarray | None = None
    implausible: str = ""
    gain: float = np.inf

    @property
    def unsure(self) -> bool:
        """Whether the interval of everything that says how strong it is holds what the model has anyway."""
        c = self.candidate
        pairs = zip(self.interval if self.interval is not None else (), c.nominal, strict=False)
        inside = [low <= nominal <= high for (low, high), nominal in pairs]
        return bool(inside) and all(inside[: c.strength or c.size])


@dataclass(frozen=True, eq=False)
class SearchState:
    """A model in the making: the nominal one, what was declared, numerics and the effects found so far.

    Attributes:
        fixed: declared effects, and numerics if any were found.
        accepted: effects found.
        windows: whitened under this model, or one before it with much the same residuals (:func:`renew`).
    """

    fixed: Effects
    accepted: tuple[AcceptedEffect, ...]
    windows: SearchWindows

    @property
    def effects(self) -> Effects:
        """All effects of the model."""
        return (*self.fixed, *effects_of(self.candidates, self.estimates))

    @property
    def candidates(self) -> list[Candidate]:
        """Those that were accepted."""
        return [a.candidate for a in self.accepted]

    @property
    def estimates(self) -> list[np.ndarray]:
        """Their parameters."""
        return [a.x for a in self.accepted]

    def with_estimates(self, x: Sequence[np.ndarray]) -> SearchState:
        """With other parameters of the effects found."""
        return replace(self, accepted=tuple(replace(a, x=v) for a, v in zip(self.accepted, x, strict=True)))

    def without(self, effect: AcceptedEffect) -> SearchState:
        """Without one of the effects found."""
        return replace(self, accepted=tuple(a for a in self.accepted if a.round != effect.round))


Progression = tuple[SearchState, tuple[Trial, ...]]
"""A model in the making and everything tried so far, round by round."""


def first_state(context: SearchContext, noise: Noise) -> SearchState:
    """Nothing found yet; ``noise`` as it looks under the declared effects."""
    declared = context.declared
    return SearchState(declared, (), whiten_windows(context, ModelStructure(declared, ()), declared, noise))


def renew(context: SearchContext, state: SearchState) -> SearchState:
    """Whiten the windows again, under the current model."""
    structure = ModelStructure(state.fixed, tuple(c.label for c in state.candidates))
    now = state.windows
    return replace(state, windows=whiten_windows(context, structure, state.effects, now.noise, now.sensitivity))


def slopes_of_accepted(context: SearchContext, state: SearchState, split: WhitenedWindows) -> np.ndarray:
    """How residuals depend on the parameters of what was accepted, (n rows, p), for fits with one candidate more.

    Measured with a coarser time step where that will do.
    """
    if not state.accepted:
        return np.zeros((context.whitened(split, state.effects).size, 0))

    step = context.coarse_step(split, state.effects)

    def at(x: np.ndarray) -> np.ndarray:
        parts = split_parameters(state.candidates, x)
        effects = (*state.fixed, *effects_of(state.candidates, parts))
        return context.whitened(split, context.with_coarse_numerics(effects, step))

    x = np.concatenate(state.estimates)
    return jacobian(at, x, at(x), parameter_box(state.candidates), everywhere=context.sim.side_by_side.map)


def refit_accepted(context: SearchContext, state: SearchState, iterations: int = 6) -> SearchState:
    """Fit what was accepted, all together."""
    if not state.accepted:
        return state
    fit = context.fit(state.windows.fit, state.fixed, state.candidates, state.estimates, iterations)
    return state.with_estimates(fit.x)


def with_its_dead_time(rest: SearchState, left_out: AcceptedEffect) -> SearchState:
    """Lags take over a delay of the same commands that is left out, as their dead time: the two are one."""
    if left_out.candidate.kind is not ActuatorDelay:
        return rest

    def taken_over(a: AcceptedEffect) -> np.ndarray:
        if a.candidate.kind is not ActuatorLag or a.candidate.target != left_out.candidate.target:
            return a.x
        return np.clip(a.x + left_out.x[0] * (np.array(a.candidate.names) == "dead_time"), *a.candidate.bounds())

    return rest.with_estimates([taken_over(a) for a in rest.accepted])


def refit_without(
    context: SearchContext, state: SearchState, effect: AcceptedEffect, good_enough: float
) -> tuple[SearchState, bool]:
    """Leave out an effect and fit the others, with the slopes that they have beside it.

    Returns:
        The state without it, and whether the fit was left, as it would not have come to a mean loss of
        ``good_enough``.
    """
    split, rest = state.windows.fit, with_its_dead_time(state.without(effect), effect)
    if not rest.accepted:
        return rest, False
    own = np.repeat([a is effect for a in state.accepted], [a.candidate.size for a in state.accepted])
    slopes = slopes_of_accepted(context, state, split)[:, ~own]
    fit = context.fit(
        split, rest.fixed, rest.candidates, rest.estimates, 6, slopes=slopes, good_enough=good_enough
    )  # fmt: skip
    return rest.with_estimates(fit.x), fit.solution.given_up

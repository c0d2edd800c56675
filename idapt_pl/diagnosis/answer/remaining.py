"""The explanations that recordings leave: the effects found, and sets of effects that do as well or nearly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idapt_pl.diagnosis.answer.equivalents import fitted_instead, is_accepted
from idapt_pl.diagnosis.answer.explanation import ExplainingEffect, Explanation, Measurement, Standing
from idapt_pl.diagnosis.answer.probabilities import probabilities
from idapt_pl.diagnosis.answer.result import Alternative
from idapt_pl.diagnosis.candidates.fit import effects_of
from idapt_pl.diagnosis.candidates.trial import Trial
from idapt_pl.diagnosis.rounds.revision import with_rival
from idapt_pl.diagnosis.state.context import SearchContext
from idapt_pl.diagnosis.state.search_state import AcceptedEffect, SearchState
from idapt_pl.effects import effect_from_dict
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.plausible import RARITY
from idapt_pl.prediction.simulator import Effects

NEARLY = 0.8
"""Share of an effect's held-out gain from which on a refused rival is worth a further recording."""


@dataclass(frozen=True, eq=False)
class JudgedExplanation:
    """An explanation, and its losses in the held-out windows, (n,)."""

    value: Explanation
    losses: np.ndarray


@dataclass(frozen=True)
class Twin:
    """What is the same as an effect by construction, and the nominal value and scale of its one parameter."""

    other: Alternative
    nominal: float
    scale: float


def describe_measurement(context: SearchContext, state: SearchState) -> Measurement:
    """How the recordings were measured and judged."""
    sim, noise = context.sim, state.windows.noise
    return Measurement(
        control_period=round(sim.control_period, 9),
        window_steps=context.steps,
        velocities=sim.velocities,
        sensor_noise=tuple(float(f"{v:.4g}") for v in noise.sensors),
        initial_state_noise=tuple(float(f"{v:.4g}") for v in noise.start),
    )


def remaining_explanations(
    context: SearchContext, state: SearchState, inseparable: Sequence[tuple[AcceptedEffect, Twin]]
) -> list[Explanation]:
    """What was found, then every explanation in which one of its effects gives way to one that does as well.

    Args:
        context: of the search.
        state: where it ended, with equivalents as of :func:`with_equivalents_of_now`.
        inseparable: effects found, and what is the same by construction.
    """
    if not state.accepted:
        return []
    left = context.loss(state.windows.held_out, state.effects)
    found = explanation(context, state.fixed, state.candidates, state.estimates, "", Standing.FOUND, left)
    last = {id(a): i for i, a in enumerate(reversed(state.accepted))}
    same = [with_twin(found, last[id(a)], twin) for a, twin in inseparable]
    rivals = (e for a in state.accepted for e in explanations_with_rivals(context, state, a, float(left.mean())))
    return with_probabilities(context, state, [found, *same, *rivals])


def with_probabilities(
    context: SearchContext, state: SearchState, explanations: Sequence[JudgedExplanation]
) -> list[Explanation]:
    """Explanations with how probable they are."""
    p = probabilities(
        [e.losses for e in explanations],
        state.windows.held_out.W.shape[1],
        [sum(len(x.free) for x in e.value.effects) for e in explanations],
        [sum(x.effect.name in RARITY for x in e.value.effects) for e in explanations],
        context.seed,
    )
    return [replace(e.value, probability=round(float(x), 4)) for e, x in zip(explanations, p, strict=True)]


def explanations_with_rivals(
    context: SearchContext, state: SearchState, effect: AcceptedEffect, left: float
) -> list[JudgedExplanation]:
    """The explanations with an equivalent in the place of an effect, then those with a rival that does nearly as well.

    ``left`` is the mean held-out loss of what was found.
    """
    equal = [with_trial(context, state, effect, t, Standing.EQUIVALENT) for t in effect.equivalent]
    refused = [t for t in effect.rivals if not is_accepted(t, state)]
    fitted = [fitted_instead(context, state, effect, t) for t in refused]
    behind = [with_trial(context, state, effect, t, Standing.RUNNER_UP) for t in fitted]
    without = float(context.loss(state.windows.held_out, state.without(effect).effects).mean())
    near = [e for e in behind if without - e.value.loss >= NEARLY * (without - left)]
    return equal + sorted(near, key=lambda e: e.value.loss)


def with_trial(
    context: SearchContext, state: SearchState, effect: AcceptedEffect, trial: Trial, standing: Standing
) -> JudgedExplanation:
    """The explanation with a trial's candidate in the place of an effect, as it was fitted there."""
    assert trial.losses is not None, "what was fitted was judged"
    other = with_rival(state, effect, trial.candidate, trial.x)
    label = trial.candidate.label
    return explanation(context, state.fixed, other.candidates, other.estimates, label, standing, trial.losses)


def explanation(
    context: SearchContext, fixed: Effects, candidates: Sequence[Candidate], x: Sequence[np.ndarray], label: str,
    standing: Standing, losses: np.ndarray,
) -> JudgedExplanation:  # fmt: skip
    """An explanation with these effects; ``label`` tells which of them is not among those found."""
    known = [ExplainingEffect(e, {}) for e in fixed if e not in context.declared]
    effects = effects_of(candidates, x)
    free = [ExplainingEffect(e, free_parameters(c)) for e, c in zip(effects, candidates, strict=True)]
    value = Explanation(standing, label, (*known, *free), float(f"{losses.mean():.4g}"), 0.0)
    return JudgedExplanation(value, losses)


def free_parameters(c: Candidate) -> dict[str, tuple[float, float]]:
    """Nominal value and scale of what can be fitted."""
    rows = zip(c.names, c.nominal, c.scale, strict=True)
    return {name: (float(nominal), float(scale)) for name, nominal, scale in rows}


def with_twin(found: JudgedExplanation, from_last: int, twin: Twin) -> JudgedExplanation:
    """The explanation found, with what is the same by construction in place of an effect.

    Args:
        found: its last effects are those that were fitted, in their order.
        from_last: how many of them follow the one in question.
        twin: of that effect.
    """
    other = twin.other
    new = effect_from_dict({"effect": other.effect, "target": other.target, "parameters": other.parameters})
    (name,) = other.parameters
    effects = list(found.value.effects)
    effects[len(effects) - 1 - from_last] = ExplainingEffect(new, {name: (twin.nominal, twin.scale)})
    label = f"{other.effect}({other.target})"
    instead = replace(found.value, standing=Standing.EQUIVALENT, instead=label, effects=tuple(effects))
    return JudgedExplanation(instead, found.losses)

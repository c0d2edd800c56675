"""How probable each effect is by itself, and which may be named if a user bears so many false ones.

An effect can be right though something else is missing as well, so it is more probable than just these effects are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idapt_pl.diagnosis.answer.explanation import Explanation, Standing
from idapt_pl.diagnosis.answer.probabilities import NEVER_SURE

Key = tuple[str, str]
"""Effect and target."""

STAND_IN = 1 / 3
"""Probability that an effect is but a stand-in for what is missing, if something else is."""

SUREST = 1 - STAND_IN * NEVER_SURE
"""The largest probability of an effect: nobody can rule out that something else is missing."""

OUTSIDE_LIBRARY = 0.5
"""Factor for laws and the like, which stand in for whatever is missing where no known effect does."""


def effect_probabilities(explanations: Sequence[Explanation]) -> dict[Key, float]:
    """How probable each effect is that was found: its share of the explanations, less what it may stand in for.

    Args:
        explanations: what was found and what does as well; what their probabilities lack to 1 is that of something
            else, or something more.

    Returns:
        By effect and target; empty where nothing was found.
    """
    found = next((e for e in explanations if e.standing is Standing.FOUND), None)
    told = sum(e.probability for e in explanations)
    if found is None:
        return {}
    made = {}
    for effect, key in zip(found.effects, keys(found), strict=True):
        share = sum(e.probability for e in explanations if key in keys(e)) / told if told > 0 else 0.0
        usual = 1.0 if effect.effect.searched else OUTSIDE_LIBRARY
        made[key] = round(share * (1.0 - STAND_IN * max(1.0 - told, 0.0)) * usual, 4)
    return made


def keys(explanation: Explanation) -> list[Key]:
    """Effects of an explanation."""
    return [(x.effect.name, x.effect.target) for x in explanation.effects]


def nameable(probable: Mapping[Key, float], rate: float) -> set[Key]:
    """The most effects of which the expected share of false ones is at most ``rate`` (Müller et al. 2004).

    Args:
        probable: each effect's probability.
        rate: false discovery rate, 0 to 1.
    """
    ranked = sorted(probable, key=lambda key: -probable[key])
    doubts = np.cumsum([1.0 - probable[key] for key in ranked])
    return set(ranked[: int(np.sum(doubts <= rate * np.arange(1, len(ranked) + 1) + 1e-12))])

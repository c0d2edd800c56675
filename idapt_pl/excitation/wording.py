"""What a motion tells apart, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from idapt_pl.diagnosis.answer.explanation import Standing
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.excitation.design import SEPARATED, Goal, MotionDesign
from idapt_pl.excitation.rivals import Rival

DECISIVE = 6.6
"""Standard deviations over all plays at which nine of ten diagnoses decide.

Losses of two explanations that are D apart differ by D² ± 2 D; what is worse by two errors is no longer considered.
"""

FEWEST_PLAYS = 2
"""One to fit, one to judge on."""


def motion_headline(design: MotionDesign, goal: Goal) -> str:
    """The outcome in a few words."""
    if goal is not Goal.SEPARATE:
        return "A motion that narrows the estimates"
    told = int((design.separations >= SEPARATED).sum())
    if not told:
        return "No safe motion tells these explanations apart"
    return "A motion that tells " + ("all" if told == len(design.separations) else "some") + " explanations apart"


def motion_in_words(design: MotionDesign, rivals: Sequence[Rival], goal: Goal) -> list[str]:
    """What the motion tells apart and what none can, and the parameters that it does not show, a sentence each."""
    if goal is not Goal.SEPARATE:
        first = "The motion is for narrowing the intervals of what was found; see the table of parameters."
        return [first, *unseen_in_words(design, rivals[0])]
    rows = zip(combinations(rivals, 2), design.separations, design.reachable, strict=True)
    pairs = [pair_in_words(first, second, apart, reachable) for (first, second), apart, reachable in rows]
    return [*pairs, *unseen_in_words(design, rivals[0])]


def unseen_in_words(design: MotionDesign, found: Rival) -> list[str]:
    """The parameters of what was found that the motion tells nothing of, in a sentence if there are any."""
    names = [f"{phrase_at(c.kind.name, c.target)}: {name}" for c in found.candidates for name in c.names]
    unknown = [n for n, d in zip(names, design.deviations, strict=True) if not np.isfinite(d)]
    return [f"This motion tells nothing of {'; '.join(unknown)}."] if unknown else []


def pair_in_words(first: Rival, second: Rival, apart: float, reachable: float) -> str:
    """What becomes of one pair."""
    pair = f"{first.name} from {second.name}"
    if apart >= SEPARATED:
        plays = plays_needed(first, second, apart)
        if plays <= FEWEST_PLAYS:
            return f"It tells {pair}: {format_number(apart)} standard deviations apart."
        return f"It tells {pair} just so ({format_number(apart)} standard deviations): play it {plays} times."
    if reachable >= SEPARATED:
        return (
            f"It does not tell {pair} ({format_number(apart)}); another motion would ({format_number(reachable)}), "
            "once the others are told apart."
        )
    best = f"No safe motion found tells {pair}: at best {format_number(reachable)} standard deviations."
    return best + nested_in_words(first, second)


def plays_needed(first: Rival, second: Rival, apart: float) -> int:
    """How often to play a motion that drives two explanations ``apart`` [standard deviations].

    A diagnosis judges those with as many parameters by all plays, others by the half that nothing is fitted to.
    """
    parts = 1 if parameters(first) == parameters(second) else 2
    return max(FEWEST_PLAYS, parts * math.ceil((DECISIVE / apart) ** 2))


def parameters(rival: Rival) -> int:
    """How many an explanation has."""
    return sum(c.size for c in rival.candidates)


def nested_in_words(first: Rival, second: Rival) -> str:
    """That one explanation has more parameters than the other, if it has."""
    if parameters(first) == parameters(second):
        return ""
    smaller, larger = sorted((first, second), key=parameters)
    return f" With its further parameters {larger.name} may do all that {smaller.name} does; prefer the simpler one."


def standing_in_words(rival: Rival) -> str:
    """Where an explanation stands in the report."""
    return {
        Standing.FOUND: "named by the diagnosis",
        Standing.EQUIVALENT: "as good on the recordings so far",
        Standing.RUNNER_UP: "nearly as good on the recordings so far",
    }[rival.standing]


def inseparable_groups(design: MotionDesign, rivals: Sequence[Rival]) -> list[list[str]]:
    """Names of explanations of which no safe motion found tells any two apart, each group with at least two.

    One may be in several groups: where A is like B and B like C, A and C may well be told apart.
    """
    pairs = combinations(range(len(rivals)), 2)
    alike = {pair for pair, best in zip(pairs, design.reachable, strict=True) if best < SEPARATED}
    largest = list[tuple[int, ...]]()
    for size in range(len(rivals), 1, -1):
        for g in combinations(range(len(rivals)), size):
            if alike.issuperset(combinations(g, 2)) and not any(set(g) < set(other) for other in largest):
                largest.append(g)
    return [[rivals[k].name for k in g] for g in sorted(largest)]

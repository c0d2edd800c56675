"""The criterion: an effect surely predicts better, by as much as matters, and a machine may have it.

It is asked when an effect is added, and again of each effect when others came. ``benchmarks/gates.py`` counts what each
part of it keeps out that nothing else would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.candidates.trial import Rejection, RejectionReason
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.plausible import plausible_range
from idapt_pl.effects.runtime import SensingEffect
from idapt_pl.effects.wording import format_number

NOTICEABLE_CHANGE = 0.03
"""Of the size that a candidate's scale calls noticeable: a further effect that is smaller is no finding, however sure.

What a found effect's law or the integration gets wrong by a per cent looks like that, unless it is much.
"""
LEFT_OVER = 1.6
"""Mean held-out loss (1 is noise) from which much is left: a change or a law is looked for, and small effects count."""
AT_THE_FLOOR = 1.05
"""The same below which nothing is left that another effect, or a rival, explains better, unless it surely does."""
SURELY_BETTER = 1.64
"""Standard errors by which it, or a rival of more parameters, must be better, as one in twenty is by chance."""
CLEAR_GAIN = 0.25
"""Share of the held-out error that is much: what removes it is needed, whatever longer replays say."""

Gate = Callable[["Judged"], Rejection | None]


@dataclass(frozen=True, eq=False)
class Judged:
    """An effect of a fitted model, and what it is judged by.

    Attributes:
        candidate: the effect.
        x: its parameters, (p,).
        gain: mean held-out loss without it minus with it.
        gain_error: standard error of that.
        level: mean held-out loss without it.
        further: whether it comes on top of effects that were found.
        settings: of the search.
    """

    candidate: Candidate
    x: np.ndarray
    gain: float
    gain_error: float
    level: float
    further: bool
    settings: SearchSettings


def within_sensors(j: Judged) -> Rejection | None:
    """An error of a sensor that would have to be larger than sensors have stands in for something else."""
    text = beyond_its_kind(j.candidate, j.x)
    return Rejection(RejectionReason.BEYOND_SENSORS, text) if text else None


def sure_gain(j: Judged) -> Rejection | None:
    """The gain's lower bound is above zero, by the spread between episodes.

    Where nothing much is left, the best of many further ones is easily better by chance.
    """
    asked = j.settings.sureness
    if asked and j.further and j.level < AT_THE_FLOOR:
        asked = max(asked, SURELY_BETTER)
    if j.gain - asked * j.gain_error > 0:
        return None
    text = f"held-out gain {j.gain:.3g} ± {j.gain_error:.2g} is not surely positive"
    return Rejection(RejectionReason.UNSURE_GAIN, text)


def share_of_error(j: Judged) -> Rejection | None:
    """It removes more than a little of the error."""
    asked = j.settings.relative_gain
    if j.gain >= asked * j.level:
        return None
    text = f"it removes {100 * j.gain / j.level:.1f} % of the held-out error, less than {100 * asked:.2g} %"
    return Rejection(RejectionReason.SMALL_GAIN, text)


def noticeable(j: Judged) -> Rejection | None:
    """A further effect is large enough to be a finding, or much was left that it explains."""
    explains = j.level > LEFT_OVER and j.gain > CLEAR_GAIN * (j.level - 1.0)
    change = j.candidate.change(j.x)
    if not j.further or change >= NOTICEABLE_CHANGE or explains:
        return None
    text = f"as a further effect it is too small to matter: {100 * change:.1g} % of its scale"
    return Rejection(RejectionReason.SMALL_CHANGE, text)


def had_by_machines(j: Judged) -> Rejection | None:
    """A machine may have it."""
    text = why_implausible(j.candidate, j.x)
    return Rejection(RejectionReason.IMPLAUSIBLE, text) if text else None


EARNED: tuple[Gate, ...] = (sure_gain, share_of_error, noticeable)
"""What an effect must go on to pass when others came."""

GATES: tuple[Gate, ...] = (within_sensors, *EARNED, had_by_machines)
"""In the order in which they are told."""


def earns_its_place(j: Judged) -> bool:
    """Whether a model needs an effect: it surely predicts better with it, and by as much as matters."""
    return all(gate(j) is None for gate in EARNED)


def objections(j: Judged) -> Iterator[tuple[Gate, Rejection]]:
    """The gates that a candidate does not pass, and why."""
    return ((gate, told) for gate in GATES if (told := gate(j)) is not None)


def objection(j: Judged) -> Rejection | None:
    """Why a refitted candidate is not accepted, if it is not."""
    return next((told for _, told in objections(j)), None)


def beyond_its_kind(c: Candidate, x: np.ndarray) -> str:
    """Whether an error of a sensor would have to be larger than sensors have, in words."""
    if c.span is None or not issubclass(c.kind, SensingEffect) or not np.isclose(c.span, x[:, None]).any():
        return ""
    return f"its estimate ran to the end of what sensors are off by ({format_number(x[0])} {c.units()[0]})"


def why_implausible(c: Candidate, x: np.ndarray) -> str:
    """What about a candidate's parameters no machine has, in words; nothing where they are plausible.

    A fit that ran to the end of what is plausible would have gone further.
    """
    if c.plausible is None:
        return ""
    reasons = []
    for k, (low, high) in enumerate(c.plausible):
        entry, (least, most) = plausible_range(c.kind.name, c.names[k], c.nominal[k]), (b[k] for b in c.possible())
        above, below = x[k] >= high - close_to(high, high - low), x[k] <= low + close_to(low, high - low)
        above, below = above and high < most, below and low > least
        if entry is not None and (above or below) and high > low:
            end = f"{format_number(high if above else low)} {c.units()[k]}".removesuffix(" 1")
            reasons.append(f"{c.names[k]} {'above' if above else 'below'} {end} is not plausible: {entry.reason}")
    return "; ".join(reasons)


def close_to(end: float, width: float) -> float:
    """How far from the end of a range a fit counts as having run there: little of the range, and of the end itself.

    Ranges of factors are wide on one side: a thousandth of 0.01 to 100 is ten times its lower end.
    """
    return min(1e-3 * width, 0.02 * abs(end) or np.inf)

"""What an effect must pass to be accepted; each gate says why one is not, or nothing.

``benchmarks/gates.py`` counts what each of them keeps out that nothing else would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.candidates.trial import Rejection, RejectionReason, Trial
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
FURTHER_SHARE, SHARE_OF_A_PARAMETER = 0.05, 0.02
"""Share of the held-out error that a further effect must remove, and that each of its parameters must."""
LEAST_FURTHER = 0.08
"""What a further effect must remove of the held-out loss, where noise leaves 1."""
SLIPS = 1e-3
"""Share of the error that was removed so far, which found effects may leave: their law is 3 % wrong, squared."""
CLEAR_GAIN = 0.25
"""Share of the held-out error that is much: what removes it is needed, whatever longer replays say."""
AT_THE_FLOOR, TYPICALLY_AT_IT, SHARE_THERE = 1.05, 1.15, 0.15
"""Mean held-out loss below which no further effect is looked for; its median below which an effect must remove so much
of the error: a few windows are wrong for another reason."""

Gate = Callable[["Judged"], Rejection | None]


@dataclass(frozen=True, eq=False)
class Judged:
    """A refitted candidate, and what it is judged by.

    Attributes:
        settings: of the search.
        trial: what became of the candidate.
        now: held-out losses without it, (n,).
        first: mean held-out loss of the model as it was given.
        further: whether it comes on top of effects that were found.
    """

    settings: SearchSettings
    trial: Trial
    now: np.ndarray
    first: float
    further: bool

    @property
    def level(self) -> float:
        """Mean held-out loss without the candidate."""
        return float(self.now.mean())

    @property
    def x(self) -> np.ndarray:
        """The candidate's parameters, (p,)."""
        return self.trial.x[-1]

    def removes(self, share: float) -> bool:
        """Whether it removes this share of the held-out error."""
        return self.trial.gain >= share * self.level


def within_sensors(j: Judged) -> Rejection | None:
    """An error of a sensor that would have to be larger than sensors have stands in for something else."""
    text = beyond_its_kind(j.trial.candidate, j.x)
    return Rejection(RejectionReason.BEYOND_SENSORS, text) if text else None


def sure_gain(j: Judged) -> Rejection | None:
    """The gain's lower bound is above zero, by the spread between episodes."""
    t = j.trial
    if t.gain - j.settings.sureness * t.gain_error > 0:
        return None
    text = f"held-out gain {t.gain:.3g} ± {t.gain_error:.2g} is not surely positive"
    return Rejection(RejectionReason.UNSURE_GAIN, text)


def share_of_error(j: Judged) -> Rejection | None:
    """Of the whole error."""
    asked = j.settings.relative_gain
    if j.removes(asked):
        return None
    text = f"it removes {100 * j.trial.gain / j.level:.1f} % of the held-out error, less than {100 * asked:g} %"
    return Rejection(RejectionReason.SMALL_GAIN, text)


def share_above_floor(j: Judged) -> Rejection | None:
    """Of what is above the noise floor."""
    asked, above = j.settings.removable_gain, max(j.level - 1.0, 0.0)
    if not above or j.trial.gain >= asked * above:
        return None
    text = f"it removes {100 * j.trial.gain / above:.1f} % of what is above the floor, less than {100 * asked:g} %"
    return Rejection(RejectionReason.SMALL_GAIN, text)


def something_left(j: Judged) -> Rejection | None:
    """A further effect, where more than noise is left."""
    if not j.further or j.level >= AT_THE_FLOOR:
        return None
    return Rejection(RejectionReason.NOISE_FLOOR, "the noise floor is reached without it")


def share_of_further(j: Judged) -> Rejection | None:
    """A further effect, by how many parameters it has."""
    asked = max(FURTHER_SHARE, SHARE_OF_A_PARAMETER * j.trial.candidate.size)
    if not j.further or j.trial.gain >= max(asked * j.level, LEAST_FURTHER):
        return None
    removed = f"{100 * j.trial.gain / j.level:.1f} %"
    text = f"as a further effect it removes {removed} of the held-out error, less than {100 * asked:g} %"
    return Rejection(RejectionReason.SMALL_GAIN, text)


def more_than_slips(j: Judged) -> Rejection | None:
    """A further effect, beside what found ones get a little wrong."""
    if not j.further or j.trial.gain >= SLIPS * (j.first - j.level):
        return None
    text = "as a further effect it removes no more than what the effects found before may get wrong by a few per cent"
    return Rejection(RejectionReason.SMALL_GAIN, text)


def noticeable(j: Judged) -> Rejection | None:
    """A further effect is large enough to matter."""
    c, gain = j.trial.candidate, j.trial.gain
    if not j.further or not too_small_a_change(c, j.x, gain, j.level):
        return None
    text = f"as a further effect it is too small to matter: {100 * c.change(j.x):.1g} % of its scale"
    return Rejection(RejectionReason.SMALL_CHANGE, text)


def typical_window(j: Judged) -> Rejection | None:
    """Not only a few windows gain."""
    if np.median(j.now) >= TYPICALLY_AT_IT or j.removes(SHARE_THERE):
        return None
    return Rejection(RejectionReason.NOISE_FLOOR, "the typical window is at the noise floor already")


def had_by_machines(j: Judged) -> Rejection | None:
    """A machine may have it."""
    text = why_implausible(j.trial.candidate, j.x)
    return Rejection(RejectionReason.IMPLAUSIBLE, text) if text else None


GATES: tuple[Gate, ...] = (
    within_sensors, sure_gain, share_of_error, share_above_floor, something_left,
    share_of_further, more_than_slips, noticeable, typical_window, had_by_machines,
)  # fmt: skip
"""In the order in which they are told."""


def objections(j: Judged) -> Iterator[tuple[Gate, Rejection]]:
    """The gates that a candidate does not pass, and why."""
    return ((gate, told) for gate in GATES if (told := gate(j)) is not None)


def objection(j: Judged) -> Rejection | None:
    """Why a refitted candidate is not accepted, if it is not."""
    return next((told for _, told in objections(j)), None)


def too_small_a_change(c: Candidate, x: np.ndarray, gain: float, level: float) -> bool:
    """Whether a further effect is too small to be a finding, and not because much was left that it explains.

    Args:
        c: the effect.
        x: its parameters, (p,).
        gain: of the mean held-out loss with it.
        level: that loss without it.
    """
    explains = level > LEFT_OVER and gain > CLEAR_GAIN * (level - 1.0)
    return c.change(x) < NOTICEABLE_CHANGE and not explains


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

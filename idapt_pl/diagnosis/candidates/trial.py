"""What became of a candidate in a round of the search, and why it was rejected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from idapt_pl.effects.candidate import Candidate


class RejectionReason(StrEnum):
    """Why a candidate was not accepted."""

    NOT_EXCITED = "not_excited"
    """The recordings would not show it."""
    CHANCE = "chance"
    """Noise alone gives such a score."""
    LOW_SCORE = "low_score"
    """Others score higher; it was not refitted."""
    POOR_FIT = "poor_fit"
    """Others leave less after a refit on few windows."""
    BEYOND_SENSORS = "beyond_sensors"
    """An error that sensors do not have: it stands in for something else."""
    IMPLAUSIBLE = "implausible"
    """Its fit ran to the end of what machines have: it stands in for something else."""
    UNSURE_GAIN = "unsure_gain"
    """It may not help on held-out episodes at all."""
    SMALL_GAIN = "small_gain"
    """It removes too little of the held-out error."""
    SMALL_CHANGE = "small_change"
    """Its estimate is too small to matter."""
    WORSE = "worse"
    """Good enough, but another one leaves less."""
    EQUIVALENT = "equivalent"
    """As good as the one accepted: the data do not tell them apart."""


@dataclass(frozen=True)
class Rejection:
    """Why a candidate was not accepted: for programs, and in words with numbers."""

    reason: RejectionReason
    text: str


@dataclass(frozen=True, eq=False)
class Trial:
    """What became of one candidate in one round.

    Attributes:
        candidate: the effect tried.
        round: counted from 0.
        score: squared whitened error that the linear screen expects it to remove, in units of what noise leaves.
        x: fitted parameters of the effects accepted before, then its own; after the screen alone its own only.
        rough_loss: mean loss after a refit on few windows; NaN for what was not refitted.
        losses: of each held-out window with it, (n,); None for what was not refined.
        gain: mean held-out loss without it minus with it.
        gain_error: standard error of that.
        rejection: why it was not accepted; None for what was, or is still in the running.
    """

    candidate: Candidate
    round: int
    score: float
    x: tuple[np.ndarray, ...] = ()
    rough_loss: float = float("nan")
    losses: np.ndarray | None = None
    gain: float = float("nan")
    gain_error: float = float("nan")
    rejection: Rejection | None = None

    @property
    def held_out(self) -> float:
        """Mean loss on held-out windows."""
        return float("nan") if self.losses is None else float(self.losses.mean())

    def rejected(self, reason: RejectionReason, text: str) -> Trial:
        """The same, not accepted."""
        return replace(self, rejection=Rejection(reason, text))

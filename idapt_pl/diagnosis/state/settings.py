"""How hard a search looks, and how sure it must be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How hard to look, and how sure to be.

    Args:
        max_effects: stop after so many.
        scout_windows: windows on which every candidate is scored.
        screened: candidates scored again on more windows.
        screen_windows: windows for that, and for the first refits.
        confirm: candidates refitted in each round.
        refined: of these, refitted once more without shortcuts and judged on held-out episodes.
        fit_windows: windows for fits of what was accepted.
        held_out_windows: windows to judge on.
        relative_gain: an effect must remove at least this share of the held-out error (squared).
        sureness: lower confidence bound of the held-out gain, in standard errors.
        z: of the score, in standard deviations under the null, family-wise.
        seconds: aim for no more than this on two cores.
        numerics: try other time steps and integrators too.
        plausible: judge causes as those of a real machine, measured on itself: what no machine has is named last, if at
            all, and what may as well be as the model has it, or makes longer replays worse, is left out. Another
            simulation may be anything, and readings of images are no measurements to replay.
        thorough: reopen choices, try what is not plausible, test whether effects change. Else effects are added as long
            as half of ``seconds`` has not passed.
    """

    max_effects: int = 8
    scout_windows: int = 40
    screened: int = 16
    screen_windows: int = 100
    confirm: int = 8
    refined: int = 5
    fit_windows: int = 250
    held_out_windows: int = 250
    relative_gain: float = 0.02
    sureness: float = 1.2
    z: float = 4.5
    seconds: float = 60.0
    numerics: bool = True
    plausible: bool = True
    thorough: bool = True


DEFAULT_SETTINGS = SearchSettings()
QUICK_SETTINGS = SearchSettings(
    max_effects=2, scout_windows=20, screened=8, screen_windows=40, confirm=4, refined=2, fit_windows=80,
    held_out_windows=120, seconds=20.0, thorough=False,
)  # fmt: skip
"""For a first answer: about twenty seconds for small machines, one to two minutes for arms of six or seven joints."""

NOT_TRIED_QUICKLY = (
    "more than two effects", "early choices once more", "causes that are not plausible",
    "whether what is found changes over time", "stretches in which the model cannot hold", "laws of force",
)  # fmt: skip
"""What a quick look leaves out, in words."""

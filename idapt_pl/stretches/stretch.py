"""Stretches as values; :meth:`StretchReport.to_dict` is the entry ``left_out`` of ``report.json``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.prediction.data import LEFT_OUT, Recording


@dataclass(frozen=True)
class Stretch:
    """Some control steps of an episode, one after the other, in which the model cannot hold.

    Attributes:
        episode: its number.
        first, last: control steps, the last one excluded.
        begin, end: the same in seconds from the episode's start.
        error: of short forecasts, in units of what is usual in the rest of the recording; None where the user gave it.
        channels: in which it is largest, the largest first.
    """

    episode: int
    first: int
    last: int
    begin: float
    end: float
    error: float | None = None
    channels: tuple[str, ...] = ()

    @property
    def found(self) -> bool:
        """Whether it was found from the recording; else the user gave it."""
        return self.error is not None

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "episode": self.episode,
            "begin_s": round(self.begin, 4),
            "end_s": round(self.end, 4),
            "found": self.found,
            "error": None if self.error is None else round(self.error, 2),
            "channels": list(self.channels),
        }


@dataclass(frozen=True, eq=False)
class ForecastErrors:
    """Errors of short forecasts along an episode, in units of what is usual in the recording.

    Attributes:
        time: where forecasts begin, seconds from the episode's start, (n,).
        error: of the worst channel, (n,).
    """

    time: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class StretchReport:
    """What was left out of a diagnosis.

    Attributes:
        stretches: in order.
        steps: control steps of the whole recording.
        lengths: of each episode, s.
        errors: of each episode, under the final model; empty where they were not looked at.
        conditions: that the user gave, as given.
        with_them: effects that were found while the stretches were in, as (effect, target).
        verdict_with_them: and the verdict; both empty where nothing was found to leave out.
    """

    stretches: tuple[Stretch, ...]
    steps: int
    lengths: tuple[float, ...]
    errors: tuple[ForecastErrors, ...] = ()
    conditions: tuple[str, ...] = ()
    with_them: tuple[tuple[str, str], ...] = ()
    verdict_with_them: str = ""

    @property
    def share(self) -> float:
        """Share of the control steps that is left out."""
        return sum(s.last - s.first for s in self.stretches) / max(self.steps, 1)

    @property
    def found(self) -> tuple[Stretch, ...]:
        """Those that were found from the recording."""
        return tuple(s for s in self.stretches if s.found)

    def to_dict(self) -> dict[str, Any]:
        """As in ``report.json``."""
        return {
            "share": round(self.share, 4),
            "conditions": list(self.conditions),
            "stretches": [s.to_dict() for s in self.stretches],
            "verdict_with_them": self.verdict_with_them,
            "effects_with_them": [{"effect": e, "target": t} for e, t in self.with_them],
        }


def marked_steps(episode: Episode) -> np.ndarray:
    """Control steps of an episode that are left out, (T,) bool."""
    marked = episode.infos.get(LEFT_OUT)
    return np.zeros(len(episode), bool) if marked is None else np.asarray(marked, bool)


def with_marks(episode: Episode, marked: np.ndarray) -> Episode:
    """An episode of which other control steps are left out."""
    infos = {k: v for k, v in episode.infos.items() if k != LEFT_OUT}
    return replace(episode, infos=infos | ({LEFT_OUT: marked} if marked.any() else {}))


def leave_out(data: Trajectories, stretches: Sequence[Stretch]) -> Trajectories:
    """Recordings of which some stretches are left out, beside what is already."""
    episodes = list(data.episodes)
    for s in stretches:
        marked = marked_steps(episodes[s.episode]).copy()
        marked[s.first : s.last] = True
        episodes[s.episode] = with_marks(episodes[s.episode], marked)
    return replace(data, episodes=tuple(episodes))


def runs_of(marked: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last (excluded) of every run of marks, (n,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(int)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def given_stretches(recordings: Sequence[Recording]) -> list[Stretch]:
    """What recordings are left out by their marks."""
    made = []
    for e, r in enumerate(recordings):
        since = r.time - r.time[0]
        for first, last in runs_of(r.left_out) if r.left_out is not None else ():
            made.append(Stretch(e, first, last, float(since[first]), float(since[last])))
    return made

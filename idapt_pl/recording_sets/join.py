"""Recordings of several files as one, and which episodes come from where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from datamodules import Trajectories

LIKE_PERIOD = 0.01
"""Control periods that differ by a smaller share are the same."""


@dataclass(frozen=True)
class RecordingSet:
    """The episodes of one file, by their numbers among all.

    Attributes:
        name: of the file.
        first, last: its episodes, the last one excluded.
    """

    name: str
    first: int
    last: int

    @property
    def episodes(self) -> range:
        """Their numbers."""
        return range(self.first, self.last)


def join_recordings(paths: Sequence[Path], each: Sequence[Trajectories]) -> tuple[Trajectories, list[RecordingSet]]:
    """All recordings one after the other, and which are whose.

    Raises:
        ValueError: a file is given twice, or control periods differ.
    """
    short = Counter(p.name for p in paths)
    names = [p.name if short[p.name] == 1 else str(p) for p in paths]
    if doubled := [n for n, count in Counter(str(p.resolve()) for p in paths).items() if count > 1]:
        raise ValueError(f"--data: {Path(doubled[0]).name} is given twice")
    sets, episodes = [], list(each[0].episodes[:0])
    for name, path, data in zip(names, paths, each, strict=True):
        if abs(data.dt - each[0].dt) > LIKE_PERIOD * each[0].dt:
            raise ValueError(
                f"{path}: its control period is {data.dt:g} s, that of {paths[0]} is {each[0].dt:g} s; "
                "recordings with different periods are diagnosed one by one"
            )
        sets.append(RecordingSet(name, len(episodes), len(episodes) + len(data)))
        episodes += data.episodes
    return Trajectories(tuple(episodes), each[0].dt, " + ".join(names)), sets

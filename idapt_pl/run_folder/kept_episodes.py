"""Episodes of a target that cannot be played again: each is kept as soon as it has ended, or was cut short."""

from __future__ import annotations

import shutil
from pathlib import Path

from datamodules import Episode, Trajectories, read_trajectories, write_trajectories
from datamodules.trajectories import count_steps

PARTS = "target_parts"
"""Of a grounding step's folder, while its recording is not complete."""


class KeptEpisodes:
    """A folder with a trajectory file for each episode, in the order in which they were recorded.

    Args:
        folder: of the grounding step.
        dt: control period, s.
        source: free text for the files.
    """

    def __init__(self, folder: Path, dt: float, source: str) -> None:
        self.folder, self.dt, self.source = folder / PARTS, dt, source

    @property
    def files(self) -> list[Path]:
        """What is there."""
        return sorted(self.folder.glob("*.h5"))

    @property
    def steps(self) -> int:
        """Control steps of all of them."""
        return sum(map(count_steps, self.files))

    def add(self, episode: Episode) -> None:
        """Keep one more."""
        path = self.folder / f"{len(self.files):06d}.h5"
        write_trajectories(path, Trajectories((episode,), self.dt, self.source))

    def read(self) -> list[Episode]:
        """All of them."""
        return [episode for file in self.files for episode in read_trajectories(file)]

    def forget(self) -> None:
        """They are in a file of their own now."""
        shutil.rmtree(self.folder, ignore_errors=True)

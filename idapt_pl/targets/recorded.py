"""A target that is known from recordings alone: made before the run, or by hand while it waits."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datamodules import Episode, Trajectories, read_trajectories
from datamodules.episode_folder import ACTIONS, read_action_names, read_action_table, read_episode_folder
from datamodules.images.fitting import Fitted
from datamodules.trajectories import TrajectoryFileError, count_steps
from idapt_pl.envs import ActionMap
from idapt_pl.targets.target import Look, Target

BEYOND = 0.05
"""Share of its range by which a recorded action may lie beyond it."""

SAME_RATE = 0.01
"""Share by which the period of a recording may differ from the source's."""

ENOUGH = 0.9
"""Share of the control steps that were asked for with which a recording by hand is taken to be complete."""


@dataclass(frozen=True)
class RecordedTarget(Target):
    """Recordings, one for each grounding step. It cannot be played, so nothing is measured in it.

    Attributes:
        name: as of :class:`Target`.
        actions: as of :class:`Target`; recordings have the target's.
        period: control period of the source, s.
        files: trajectory files, or folders of episodes, one for each grounding step.
        inbox: where recordings are put by hand, instead of ``files``: trajectory files and folders of episodes in
            ``<inbox>/step_<k>``.
    """

    name: str
    actions: ActionMap
    period: float
    files: tuple[Path, ...] = ()
    inbox: Path | None = None
    playable: bool = False
    measured: bool = False
    mean_actions: bool = True

    def recording(self, k: int, look: Look) -> Trajectories:
        """What there is for a grounding step: images and actions, as the run sees and names them.

        Raises:
            ValueError: naming the file, and what is wrong with it.
        """
        paths = self.brought(k) if self.inbox is not None else [*map(there, self.files[k : k + 1])]
        if not paths:
            raise ValueError(f"target.recordings has {len(self.files)} files, none for grounding step {k}")
        episodes = [e for path in paths for e in self.episodes(path, look.image_size)]
        return Trajectories(tuple(episodes), self.period, f"{self.name}, {', '.join(map(str, paths))}")

    def look_for(self, look: Look, recorded: Collection[int] = ()) -> None:
        for k, path in enumerate(self.files):
            if k not in recorded:
                there(path)

    def brought(self, k: int) -> list[Path]:
        """Files and folders of episodes that were put there for a grounding step."""
        return sorted(p for p in self.place(k).glob("*") if p.suffix == ".h5" or (p / ACTIONS).exists())

    def steps_brought(self, k: int) -> int:
        """Control steps that were put there for a grounding step.

        Raises:
            TrajectoryFileError: if a file cannot be read.
        """
        return sum(len(read_action_table(p / ACTIONS)) if p.is_dir() else count_steps(p) for p in self.brought(k))

    def place(self, k: int) -> Path:
        """Where recordings for a grounding step are put."""
        assert self.inbox is not None
        return self.inbox / f"step_{k:02d}"

    def episodes(self, path: Path, image_size: int) -> list[Episode]:
        """Episodes of a file, without states and rewards, with images of the run's size and the source's actions.

        Raises:
            TrajectoryFileError: if it does not suit.
        """
        for folder in episode_folders(path):
            self.check_names(folder / ACTIONS)
        recorded = read_any(path, self.period)
        if abs(recorded.dt - self.period) > SAME_RATE * self.period:
            raise TrajectoryFileError(
                f"{path}: one step every {recorded.dt:g} s, the source's are {self.period:g} s long. Record at that "
                "rate, make the source's steps as long (task_options: {action_repeat: ...})"
                + (f", or resample: idapt import --period {self.period:g}" if recorded.dt < self.period else "")
            )
        fit, nu, made = Fitted(image_size, image_size, "crop"), len(self.actions.low), []
        for i, episode in enumerate(recorded):
            pixels = episode.observations.get("pixels")
            if pixels is None:
                raise TrajectoryFileError(f"{path}: episode {i} has no images (observations/pixels, (T+1, H, W, 3))")
            if episode.actions.shape[1:] != (nu,):
                raise TrajectoryFileError(
                    f"{path}: episode {i} has actions of {episode.actions.shape[1]} numbers, the source of {nu}"
                )
            frames, actions = np.stack([fit(frame) for frame in pixels]), self.actions.back(episode.actions)
            self.check_bounds(f"{path}: episode {i}", actions)
            made.append(Episode(actions, {"pixels": frames}))
        return made

    def check_names(self, table: Path) -> None:
        """Columns that are named as the target's actions must be in their order.

        Raises:
            TrajectoryFileError: if they are in another.
        """
        names, expected = read_action_names(table), list(self.actions.names)
        if names != expected and sorted(names) == sorted(expected):
            raise TrajectoryFileError(
                f"{table}: its columns are {', '.join(names)}; expected in the order {', '.join(expected)}. Change the "
                "file, or say target.actions.order"
            )

    def check_bounds(self, what: str, actions: np.ndarray) -> None:
        """Recorded actions must be what the source's actuators can be told.

        Raises:
            TrajectoryFileError: if they are far beyond.
        """
        low, high = np.asarray(self.actions.low), np.asarray(self.actions.high)
        beyond = np.maximum(low - actions, actions - high) > BEYOND * (high - low)
        if beyond.any():
            step, j = np.argwhere(beyond)[0]
            raise TrajectoryFileError(
                f"{what}: action {j} of step {step} is {actions[step, j]:g} in the source's units, whose range is "
                f"{low[j]:g} to {high[j]:g}. Are units or order others (target.actions)? If the robot cut it off, "
                "record what it played"
            )


def there(path: Path) -> Path:
    """A recording, as it is.

    Raises:
        ValueError: if it is not there, or neither a trajectory file nor a folder.
    """
    if not path.exists():
        raise ValueError(f"target.recordings: {path} is not there")
    if not path.is_dir() and path.suffix != ".h5":
        raise ValueError(
            f"target.recordings: {path} is neither a trajectory file (.h5) nor a folder of pictures and {ACTIONS}. "
            "idapt import makes a trajectory file of other formats"
        )
    return path


def read_any(path: Path, period: float) -> Trajectories:
    """A trajectory file, an episode's folder, or a folder of such folders, whose control period is taken to be right.

    Raises:
        TrajectoryFileError: if it is none of them.
    """
    if not path.is_dir():
        return read_trajectories(path)
    folders = episode_folders(path)
    inside = [] if folders == [path] else sorted(p for p in path.iterdir() if p.is_dir() and p.name[0] not in "._")
    if folders and (without := [p for p in inside if p not in folders]):
        raise TrajectoryFileError(f"{without[0]}: has no {ACTIONS}, as the other episodes of {path} have")
    if not folders:
        raise TrajectoryFileError(f"{path}: holds no episodes; expected {ACTIONS} beside pictures, or folders of both")
    return Trajectories(tuple(map(read_episode_folder, folders)), period, str(path))


def episode_folders(path: Path) -> list[Path]:
    """Folders with an episode each: a folder itself, or those in it; none of a file."""
    return [path] if (path / ACTIONS).exists() else sorted(f.parent for f in path.glob(f"*/{ACTIONS}"))

"""Trajectories and the HDF5 file they live in (Minari's episode layout; see docs/reference/files.md)."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np

from datamodules.atomic import remove_stale, write_bytes


class TrajectoryFileError(ValueError):
    """A trajectory file is missing, truncated or not what it should be; the message says which and where."""


@dataclass(frozen=True)
class Episode:
    """One episode of T control steps: T actions between T+1 observations.

    Attributes:
        actions: float32 (T, nu), in the actuators' units, held from t_k to t_{k+1}.
        observations: name to array with T+1 rows; ``pixels`` is uint8 (T+1, H, W, 3).
        rewards, terminations, truncations: (T,); the source only, None in the target.
        timestamps: s, (T+1,); None where sampling is regular.
        infos: name to array, other measured channels.

    Raises:
        ValueError: naming the array whose shape, type or values are not as above.
    """

    actions: np.ndarray
    observations: dict[str, np.ndarray]
    rewards: np.ndarray | None = None
    terminations: np.ndarray | None = None
    truncations: np.ndarray | None = None
    timestamps: np.ndarray | None = None
    infos: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        T = len(self.actions)
        if self.actions.ndim != 2 or T == 0:
            raise ValueError(f"actions have shape {self.actions.shape}, expected (T, nu) with T >= 1")
        if not np.isfinite(self.actions).all():
            raise ValueError("actions hold NaN or infinite values")
        for name, array in self.observations.items():
            if len(array) != T + 1:
                raise ValueError(f"observations/{name} has {len(array)} rows, expected T+1 = {T + 1}")
        pixels = self.observations.get("pixels")
        if pixels is not None and (pixels.dtype != np.uint8 or pixels.ndim != 4 or pixels.shape[-1] != 3):
            raise ValueError(f"observations/pixels is {pixels.dtype} {pixels.shape}, expected uint8 (T+1, H, W, 3)")
        for name in ("rewards", "terminations", "truncations"):
            array = getattr(self, name)
            if array is not None and array.shape != (T,):
                raise ValueError(f"{name} has shape {array.shape}, expected (T,) = ({T},)")
        if self.timestamps is not None and (
            self.timestamps.shape != (T + 1,) or not (np.diff(self.timestamps) > 0).all()
        ):
            raise ValueError(f"timestamps must be {T + 1} increasing numbers, got shape {self.timestamps.shape}")

    def __len__(self) -> int:
        return len(self.actions)

    def part(self, first: int, last: int) -> Episode:
        """Control steps ``first`` to before ``last``, with the observations before and after each of them."""
        T = len(self)

        def of_steps(a: np.ndarray | None) -> np.ndarray | None:
            return None if a is None else a[first:last]

        return Episode(
            self.actions[first:last],
            {name: a[first : last + 1] for name, a in self.observations.items()},
            of_steps(self.rewards), of_steps(self.terminations), of_steps(self.truncations),
            None if self.timestamps is None else self.timestamps[first : last + 1],
            {n: a[first : last + (len(a) > T)] if len(a) in (T, T + 1) else a for n, a in self.infos.items()},
        )  # fmt: skip


@dataclass(frozen=True)
class Trajectories:
    """Episodes recorded at one control period.

    Attributes:
        episodes: the episodes.
        dt: control period, s.
        source: free text, where the data come from.
    """

    episodes: tuple[Episode, ...]
    dt: float
    source: str = ""

    def __len__(self) -> int:
        return len(self.episodes)

    def __iter__(self) -> Iterator[Episode]:
        return iter(self.episodes)

    @property
    def total_steps(self) -> int:
        """Control steps in all episodes."""
        return sum(map(len, self.episodes))

    def __add__(self, other: Trajectories) -> Trajectories:
        return Trajectories(self.episodes + other.episodes, self.dt, self.source)


def cut_in_time(trajectories: Trajectories, edges: Sequence[int]) -> Trajectories:
    """Each episode as several, from control step to control step; they share the observation where they meet."""
    parts = tuple(episode.part(a, b) for episode in trajectories for a, b in pairwise(edges))
    return Trajectories(parts, trajectories.dt, trajectories.source)


def content_hash(episodes: Iterable[Episode]) -> str:
    """SHA-256 of all actions and observations, in order: the same data, the same hash, however it is stored."""
    digest = hashlib.sha256()
    for episode in episodes:
        for array in (episode.actions, *(episode.observations[name] for name in sorted(episode.observations))):
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def write_trajectories(path: Path | str, trajectories: Trajectories) -> None:
    """Write a trajectory file: built in memory, to a temporary name, then renamed. A full disk leaves nothing behind.

    HDF5 itself never sees the disk: a full one crashes the library. While it is written, a file takes as much memory
    as it will take on disk, compressed, beside what ``trajectories`` take.

    Raises:
        OSError: if it could not be written.
    """
    path = Path(path)
    if path.parent.is_dir():
        remove_stale(path)
    buffer = io.BytesIO()
    try:
        with h5py.File(buffer, "w") as f:
            f.attrs.update(
                total_episodes=len(trajectories),
                total_steps=trajectories.total_steps,
                dt=trajectories.dt,
                source=trajectories.source,
            )
            for i, episode in enumerate(trajectories):
                _write_episode(f.create_group(f"episode_{i}"), i, episode)
    except (OSError, RuntimeError) as error:
        raise OSError(f"could not write {path}: {error}. Nothing was left half-written.") from None
    write_bytes(path, buffer.getbuffer())


def read_trajectories(path: Path | str) -> Trajectories:
    """Read and check a trajectory file.

    Raises:
        TrajectoryFileError: naming the file, the dataset, what was expected and what came.
    """
    with open_trajectory_file(path) as f:
        try:
            number, noted, dt = int(f.attrs["total_episodes"]), int(f.attrs["total_steps"]), float(f.attrs["dt"])
        except (TypeError, ValueError, OverflowError):
            raise TrajectoryFileError(
                f"{path}: the root attributes total_episodes, total_steps and dt must be numbers"
            ) from None
        episodes = tuple(_read_episode(path, f, i) for i in range(number))
        trajectories = Trajectories(episodes, dt, str(f.attrs.get("source", "")))
    if trajectories.total_steps != noted:
        raise TrajectoryFileError(
            f"{path}: its episodes have {trajectories.total_steps} actions, but its attribute total_steps is {noted}"
        )
    return trajectories


def count_steps(path: Path | str) -> int:
    """Control steps in a trajectory file: the actions that it holds, whatever its attributes say.

    Raises:
        TrajectoryFileError: if they cannot be read.
    """
    with open_trajectory_file(path) as f:
        try:
            return sum(len(group["actions"]) for name, group in f.items() if name.startswith("episode_"))
        except Exception as error:
            raise TrajectoryFileError(f"{path}: its actions cannot be counted: {error}") from None


def open_trajectory_file(path: Path | str) -> h5py.File:
    """Open for reading.

    Raises:
        TrajectoryFileError: if it is missing, truncated or no trajectory file.
    """
    path = Path(path)
    if not path.is_file():
        raise TrajectoryFileError(f"{path}: no such file; expected a trajectory file (HDF5)")
    try:
        f = h5py.File(path, "r")
    except Exception as error:  # h5py reports damage as any of its errors
        cure = "" if path.suffix in (".h5", ".hdf5") else ". `idapt import` makes a trajectory file of other recordings"
        raise TrajectoryFileError(
            f"{path}: not a readable HDF5 file (truncated or of another kind): {error}{cure}"
        ) from None
    for name, number in {"total_episodes": int, "total_steps": int, "dt": float}.items():
        try:
            number(f.attrs[name])
        except Exception as error:
            f.close()
            told = "is missing" if isinstance(error, KeyError) else f"cannot be read: {error}"
            raise TrajectoryFileError(
                f"{path}: not a trajectory file: root attribute {name!r} {told}; see docs/reference/files.md"
            ) from None
    return f


def _write_episode(group: h5py.Group, i: int, episode: Episode) -> None:
    group.attrs.update(id=i, total_steps=len(episode))
    group["actions"] = episode.actions
    for name, array in episode.observations.items():
        images = {"chunks": (1, *array.shape[1:]), "compression": "gzip", "compression_opts": 1}
        group.create_dataset(f"observations/{name}", data=array, **(images if array.ndim == 4 else {}))
    for name in ("rewards", "terminations", "truncations", "timestamps"):
        if getattr(episode, name) is not None:
            group[name] = getattr(episode, name)
    for name, array in episode.infos.items():
        group[f"infos/{name}"] = array


def _read_episode(path: Path | str, f: h5py.File, i: int) -> Episode:
    where = f"{path}: episode_{i}"
    try:
        group = f[f"episode_{i}"]
        optional = ("rewards", "terminations", "truncations", "timestamps")
        return Episode(
            actions=group["actions"][()],
            observations={name: data[()] for name, data in group["observations"].items()},
            **{name: group[name][()] if name in group else None for name in optional},
            infos={name: data[()] for name, data in group["infos"].items()} if "infos" in group else {},
        )
    except KeyError as error:
        raise TrajectoryFileError(f"{where}: expected a group or dataset that is missing: {error}") from None
    except ValueError as error:
        raise TrajectoryFileError(f"{where}: {error}") from None
    except Exception as error:  # h5py reports damage as any of its errors
        raise TrajectoryFileError(f"{where}: could not be read, the file may be damaged: {error}") from None

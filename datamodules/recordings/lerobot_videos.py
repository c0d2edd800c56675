"""Videos of LeRobot datasets: one for each episode (v2), or several episodes in one (v3)."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np

from datamodules.recordings.errors import RecordingError
from datamodules.recordings.frames import video_frames
from datamodules.recordings.mapping import ImageColumn


def add_videos(
    path: Path, episodes: dict[int | None, dict[str, np.ndarray]], images: ImageColumn, parquet: ModuleType
) -> None:
    """Give episodes the frames of a feature that is a video, as a column; nothing if it is none.

    Args:
        path: folder of the dataset.
        episodes: columns by index.
        images: which feature.
        parquet: pyarrow's module.

    Raises:
        RecordingError: if a video or what ``meta`` says of it is not as it should be.
    """
    about = path / "meta" / "info.json"
    if not about.is_file():
        return
    info = json.loads(about.read_text())
    if info.get("features", {}).get(images.column, {}).get("dtype") != "video":
        return
    try:
        several = int(str(info["codebase_version"]).removeprefix("v").split(".")[0]) >= 3
        places = shared_videos(path, images.column, info["fps"], parquet) if several else {}
        for index, columns in episodes.items():
            if index is None:
                raise RecordingError(f"{path}: rows without episode_index have no video")
            file, first = places[index] if several else (own_video(path, images.column, index, info), 0)
            count = max(len(column) for column in columns.values())
            columns[images.column] = video_frames(file, first, count, images.size)
    except KeyError as error:
        raise RecordingError(f"{path}: meta does not say where the videos of {images.column} are: {error}") from None


def own_video(path: Path, feature: str, index: int, info: dict) -> Path:
    """The video of an episode (v2)."""
    chunk = index // int(info.get("chunks_size", 1000))
    return path / f"videos/chunk-{chunk:03d}/{feature}/episode_{index:06d}.mp4"


def shared_videos(path: Path, feature: str, fps: float, parquet: ModuleType) -> dict[int, tuple[Path, int]]:
    """The video that every episode is in, and its first frame there (v3).

    Raises:
        KeyError: if the dataset does not say.
    """
    found: dict[int, tuple[Path, int]] = {}
    key = f"videos/{feature}"
    for file in sorted((path / "meta" / "episodes").rglob("*.parquet")):
        for row in parquet.read_table(file).to_pylist():
            chunk, number = row[f"{key}/chunk_index"], row[f"{key}/file_index"]
            first = round(row[f"{key}/from_timestamp"] * fps)
            found[row["episode_index"]] = path / f"{key}/chunk-{chunk:03d}/file-{number:03d}.mp4", first
    return found

"""LeRobot datasets (v2 and v3): a folder with ``meta/info.json`` and parquet files, or one parquet file."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from datamodules.recordings.errors import RecordingError, optional
from datamodules.recordings.frames import decoded_image, fitted_frames
from datamodules.recordings.lerobot_videos import add_videos
from datamodules.recordings.mapping import ImageColumn, Mapping
from datamodules.recordings.recorded import Recorded, flat_columns

EPISODE = "episode_index"


def read_lerobot(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read every episode: columns ``timestamp``, ``action[0]``, ``observation.state[shoulder_pan.pos]``, ...

    Elements go by number and, where ``info.json`` names them, by name. Of images and videos that which the map asks for
    is read.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    parquet = optional("pyarrow.parquet", "pyarrow", path)
    files = sorted((path / "data").rglob("*.parquet")) if path.is_dir() else [path]
    if not files:
        raise RecordingError(f"{path}: not a LeRobot dataset: expected data/chunk-*/*.parquet")
    labels = _labels(path) if path.is_dir() else {}
    episodes: dict[int | None, list[dict[str, np.ndarray]]] = {}
    for file in files:
        for index, columns in _episodes(file, parquet, mapping.images):
            episodes.setdefault(index, []).append(columns)
    joined = {index: _joined(parts, labels) for index, parts in sorted(episodes.items(), key=lambda e: e[0] or 0)}
    if mapping.images is not None and path.is_dir():
        add_videos(path, joined, mapping.images, parquet)
    return [Recorded(f"{path}: episode {i}" if i is not None else str(path), columns) for i, columns in joined.items()]


def _episodes(
    file: Path, parquet: ModuleType, images: ImageColumn | None
) -> list[tuple[int | None, dict[str, np.ndarray]]]:
    """Episode index, None where the file has none, and arrays (rows,) or (rows, n) of the episodes in a file."""
    pyarrow = optional("pyarrow", "pyarrow", file)
    try:
        table = parquet.read_table(file)
    except (OSError, pyarrow.ArrowException) as error:
        raise RecordingError(f"{file}: not a readable parquet file: {str(error).splitlines()[0]}") from None
    arrays = {name: a for name in table.column_names if (a := _array(table.column(name))) is not None}
    if images is not None and images.column in table.column_names:
        pictures = table.column(images.column).to_pylist()  # {"bytes": ..., "path": ...}
        arrays[images.column] = fitted_frames((_picture(p, file) for p in pictures), images.size)
    if EPISODE not in arrays:
        return [(None, arrays)]
    index = arrays[EPISODE]
    return [(int(i), {name: a[index == i] for name, a in arrays.items()}) for i in np.unique(index)]


def _picture(cell: Any, file: Path) -> np.ndarray:
    data = cell.get("bytes") if isinstance(cell, dict) else cell
    if not isinstance(data, bytes):
        raise RecordingError(f"{file}: expected a picture's bytes, got {type(data).__name__}")
    return decoded_image(data, str(file))


def _array(column: Any) -> np.ndarray | None:
    """Numbers (rows,) or (rows, n), or text (rows,); None for images and ragged lists. Nulls become NaN."""
    kind = str(column.type)
    if kind.startswith(("struct", "binary", "large_binary")):
        return None
    if "list" not in kind:
        return column.to_numpy()
    rows = column.to_pylist()
    width = max((len(row) for row in rows if row is not None), default=0)
    rows = [[np.nan] * width if row is None else row for row in rows]
    try:
        array = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return array if array.ndim == 2 else None


def _joined(parts: list[dict[str, np.ndarray]], labels: dict[str, list[str]]) -> dict[str, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    for name in parts[0]:
        pieces = [part[name] for part in parts if name in part]
        if len({piece.shape[1:] for piece in pieces}) == 1:
            whole = np.concatenate(pieces)
            columns |= {name: whole} if whole.ndim == 4 else flat_columns(name, whole, labels.get(name))
    return columns


def _labels(path: Path) -> dict[str, list[str]]:
    """Names of the elements of each feature, from ``meta/info.json``."""
    info = path / "meta" / "info.json"
    if not info.is_file():
        return {}
    try:
        features = json.loads(info.read_text())["features"]
        names = {feature: about.get("names") for feature, about in features.items()}
    except (ValueError, KeyError, AttributeError) as error:
        raise RecordingError(f"{info}: expected the features of a LeRobot dataset: {error!r}") from None
    for feature, value in names.items():  # a list, or {"motors": a list}
        if isinstance(value, dict) and len(value) == 1:
            names[feature] = next(iter(value.values()))
    return {f: [str(v) for v in value] for f, value in names.items() if isinstance(value, list)}

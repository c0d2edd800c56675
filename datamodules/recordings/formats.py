"""The formats, which of them a recording is in, and its reader."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

from datamodules.recordings.errors import RecordingError
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.read_csv import read_csv
from datamodules.recordings.read_jsonl import read_jsonl
from datamodules.recordings.read_lerobot import read_lerobot
from datamodules.recordings.read_mcap import read_mcap
from datamodules.recordings.read_minari import read_minari
from datamodules.recordings.read_npz import read_npz
from datamodules.recordings.read_rosbag1 import read_rosbag1
from datamodules.recordings.read_rosbag2 import read_rosbag2
from datamodules.recordings.read_ulog import read_ulog
from datamodules.recordings.recorded import Recorded

FORMATS: dict[str, Callable[[Path, Mapping], list[Recorded]]] = {
    "csv": read_csv,
    "npz": read_npz,
    "minari": read_minari,
    "lerobot": read_lerobot,
    "mcap": read_mcap,
    "rosbag1": read_rosbag1,
    "rosbag2": read_rosbag2,
    "ulog": read_ulog,
    "jsonl": read_jsonl,
}

SUFFIXES = {
    **{".csv": "csv", ".tsv": "csv", ".txt": "csv", ".npz": "npz", ".mcap": "mcap", ".parquet": "lerobot"},
    **{".hdf5": "minari", ".h5": "minari", ".bag": "rosbag1", ".db3": "rosbag2", ".ulg": "ulog", ".jsonl": "jsonl"},
}


def read_recording(path: Path | str, mapping: Mapping, format: str | None = None) -> list[Recorded]:
    """Read a recording's episodes as named columns.

    Args:
        path: a file, a dataset's folder, or the id of a local Minari dataset.
        mapping: says which columns are wanted and how a CSV is written.
        format: one of ``FORMATS``; None: told by the name.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    path = find(path, format)
    kind = format or guess(path)
    try:
        episodes = FORMATS[kind](path, mapping)
    except (RecordingError, MemoryError):
        raise
    except Exception as error:  # the packages that read a format raise what they like on bytes they cannot read
        told = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise RecordingError(f"{path}: not readable as {kind} (truncated or of another kind): {told}") from None
    if not episodes:
        raise RecordingError(f"{path}: holds no episodes")
    return episodes


def find(path: Path | str, format: str | None) -> Path:
    """The recording's path; a Minari id such as ``door/human-v2`` is looked up among the local datasets.

    Raises:
        RecordingError: if there is no such file, folder or dataset.
    """
    found = Path(path)
    if not found.exists() and (format == "minari" or (format is None and re.fullmatch(r".+-v\d+", str(path)))):
        root = os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets"
        found = Path(root) / path
        if not found.exists():
            raise RecordingError(f"{path}: no such file, nor a Minari dataset at {found}; minari download {path}")
    if not found.exists():
        raise RecordingError(f"{path}: no such file or folder; expected a recording")
    return found


def guess(path: Path) -> str:
    """The format, a key of ``FORMATS``, from the suffix or from what lies in the folder.

    Raises:
        RecordingError: if neither tells.
    """
    if path.is_dir():
        if (path / "meta" / "info.json").is_file():
            return "lerobot"
        if (path / "data" / "main_data.hdf5").is_file() or (path / "data" / "metadata.json").is_file():
            return "minari"
        if (path / "metadata.yaml").is_file() or any(path.glob("*.db3")):
            return "rosbag2"
        raise RecordingError(
            f"{path}: a folder, but no LeRobot dataset (meta/info.json) nor Minari dataset (data/main_data.hdf5) "
            "nor rosbag2 bag (metadata.yaml); name the files in it one by one"
        )
    if path.suffix.lower() not in SUFFIXES:
        raise RecordingError(f"{path}: the name does not tell its format; say --format {'|'.join(FORMATS)}")
    return SUFFIXES[path.suffix.lower()]

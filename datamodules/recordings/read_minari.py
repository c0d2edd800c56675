"""Minari datasets; also any HDF5 file in that layout, such as a trajectory file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datamodules.recordings.errors import RecordingError, optional
from datamodules.recordings.frames import image_column
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded, flat_columns

GROUPS = ("observations", "actions", "rewards", "terminations", "truncations", "timestamps", "infos")


def read_minari(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read every episode: columns ``observations[0]``, ``observations/qpos[0]``, ``actions[0]``, ...

    Observations have one row more than actions, as in a trajectory file.

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    if not path.is_dir():
        return _read_hdf5(path, mapping)
    data = path / "data" if (path / "data").is_dir() else path
    if (data / "main_data.hdf5").is_file():
        return _read_hdf5(data / "main_data.hdf5", mapping)
    if not (data / "metadata.json").is_file():
        raise RecordingError(f"{path}: not a Minari dataset: expected data/main_data.hdf5 or data/metadata.json")
    return _read_with_minari(path, data)


def _read_hdf5(path: Path, mapping: Mapping) -> list[Recorded]:
    try:
        with h5py.File(path, "r") as f:
            names = sorted((k for k in f if k.startswith("episode_")), key=_number)
            if not names:
                raise RecordingError(f"{path}: expected groups episode_0, episode_1, ...; it has {', '.join(f) or '-'}")
            return [Recorded(f"{path}: {name}", _columns(f[name], mapping)) for name in names]
    except OSError as error:
        raise RecordingError(f"{path}: not a readable HDF5 file (truncated or of another kind): {error}") from None


def _number(episode: str) -> tuple[int, str]:
    digits = episode.removeprefix("episode_")
    return (int(digits) if digits.isdigit() else 0, episode)


def _columns(group: h5py.Group, mapping: Mapping) -> dict[str, np.ndarray]:
    arrays: dict[str, h5py.Dataset] = {}
    group.visititems(lambda name, item: arrays.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    columns: dict[str, np.ndarray] = {}
    for name, dataset in arrays.items():
        if 1 <= dataset.ndim <= 2 and dataset.dtype.kind in "fiub":
            columns |= flat_columns(name, dataset[()])
        elif mapping.images is not None and name == mapping.images.column:
            columns |= image_column(name, dataset[()], mapping)
    return columns


def _read_with_minari(path: Path, data: Path) -> list[Recorded]:
    """Datasets that Minari keeps in another format than HDF5."""
    minari = optional("minari", "Minari", path)
    try:
        dataset = minari.MinariDataset(data)
        episodes = list(dataset.iterate_episodes())
    except ImportError as error:
        raise RecordingError(f'{path}: {error}; pip install "idapt[import]"') from None
    except (ValueError, OSError, KeyError, json.JSONDecodeError) as error:
        raise RecordingError(f"{path}: Minari could not read it: {error}") from None
    return [
        Recorded(f"{path}: episode_{e.id}", _nested({g: getattr(e, g) for g in GROUPS if hasattr(e, g)}))
        for e in episodes
    ]


def _nested(value: Any, name: str = "") -> dict[str, np.ndarray]:
    """Columns of nested dicts of arrays, names joined by slashes as in HDF5."""
    if not isinstance(value, dict):
        array = np.asarray(value)
        return flat_columns(name, array) if array.dtype.kind in "fiub" else {}
    columns: dict[str, np.ndarray] = {}
    for key, part in value.items():
        columns |= _nested(part, f"{name}/{key}" if name else key)
    return columns

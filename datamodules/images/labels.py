"""State labels of images, from a CSV, NPZ or HDF5 file."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from datamodules.images.files import ImageError


def read_labels(path: Path, names: Sequence[str]) -> np.ndarray:
    """States float32 (n, s) of the n images called ``names`` (paths relative to their folder).

    CSV: a column ``file``, all others numbers. NPZ and HDF5: an array ``state`` (n, s), and ``names`` (n,) with the
    files' names; without them the rows are those of the images in order of their names, and there are as many.

    Raises:
        ImageError: naming the file, what was expected and what came.
    """
    if not path.is_file():
        raise ImageError(f"{path}: no such file; expected the images' states as CSV, NPZ or HDF5")
    readers = {".csv": from_csv, ".npz": from_npz, ".h5": from_hdf5, ".hdf5": from_hdf5}
    if path.suffix.lower() not in readers:
        raise ImageError(
            f"{path}: labels are read from {', '.join(readers)}, not from {path.suffix or 'such a file'!r}"
        )
    files, states = readers[path.suffix.lower()](path)
    if states.ndim != 2 or not states.shape[1] or not np.isfinite(states).all():
        raise ImageError(f"{path}: state is {states.dtype} {states.shape}; expected finite numbers (images, size)")
    if files is None:
        if len(states) != len(names):
            raise ImageError(f"{path}: has {len(states)} states for {len(names)} images; expected one for each")
        return states.astype(np.float32)
    rows = {file: i for i, file in enumerate(files)}
    if missing := [name for name in names if name not in rows]:
        few = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        raise ImageError(
            f"{path}: has no label for {len(missing)} of {len(names)} images: {few}; "
            f"it names files like {files[0] if files else 'none'!r}"
        )
    return states[[rows[name] for name in names]].astype(np.float32)


def from_csv(path: Path) -> tuple[list[str], np.ndarray]:
    """Names and states of a CSV file: (n,) and (n, s).

    Raises:
        ImageError: naming the file, what was expected and what came.
    """
    with open(path, newline="", encoding="utf-8-sig") as f:
        rows = list(csv.DictReader(f))
    if not rows or "file" not in rows[0]:
        raise ImageError(f"{path}: expected a header line with a column 'file', and a line for each image")
    values = []
    for line, row in enumerate(rows, 2):
        try:
            values.append([float(v) for k, v in row.items() if k != "file"])
        except (TypeError, ValueError):
            raise ImageError(f"{path}, line {line}: expected a number in every column but 'file', got {row}") from None
    return [row["file"] for row in rows], np.array(values)


def from_npz(path: Path) -> tuple[list[str] | None, np.ndarray]:
    """Names, if there are any, and states of a NumPy archive: (n,) and (n, s).

    Raises:
        ImageError: naming the file, what was expected and what came.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files if name in ("names", "state")}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError) as error:
        raise ImageError(f"{path}: not a readable NPZ archive (truncated or of another kind): {error}") from None
    return from_arrays(path, arrays)


def from_hdf5(path: Path) -> tuple[list[str] | None, np.ndarray]:
    """Names, if there are any, and states of an HDF5 file: (n,) and (n, s).

    Raises:
        ImageError: naming the file, what was expected and what came.
    """
    try:
        with h5py.File(path, "r") as f:
            arrays = {name: f[name][()] for name in ("names", "state") if name in f}
    except OSError as error:
        raise ImageError(f"{path}: not a readable HDF5 file (truncated or of another kind): {error}") from None
    return from_arrays(path, arrays)


def from_arrays(path: Path, arrays: dict[str, np.ndarray]) -> tuple[list[str] | None, np.ndarray]:
    """Names, if there are any, and states, of the arrays ``names`` (n,) and ``state`` (n, s) of a file.

    Raises:
        ImageError: naming the file, what was expected and what came.
    """
    if "state" not in arrays:
        raise ImageError(f"{path}: has no array 'state'; expected one of shape (images, size)")
    if arrays["state"].dtype.kind not in "fiu":
        raise ImageError(f"{path}: state is {arrays['state'].dtype}; expected numbers")
    files = arrays.get("names")
    if files is None:
        return None, arrays["state"]
    if len(files) != len(arrays["state"]):
        raise ImageError(f"{path}: names has {len(files)} entries and state {len(arrays['state'])}; expected as many")
    return [f.decode() if isinstance(f, bytes) else str(f) for f in files], arrays["state"]

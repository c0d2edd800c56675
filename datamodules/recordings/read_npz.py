"""NumPy archives: one array a quantity, (rows,) or (rows, n)."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from datamodules.recordings.errors import RecordingError
from datamodules.recordings.frames import image_column
from datamodules.recordings.mapping import Mapping
from datamodules.recordings.recorded import Recorded, flat_columns


def read_npz(path: Path, mapping: Mapping) -> list[Recorded]:
    """Read an archive as one episode: ``q`` of shape (rows, 2) has columns ``q[0]`` and ``q[1]``.

    Images are uint8 (rows, H, W, 3).

    Raises:
        RecordingError: naming the file, what was expected and what came.
    """
    columns: dict[str, np.ndarray] = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                columns |= image_column(name, array := _array(archive, name), mapping) or flat_columns(name, array)
    except (OSError, ValueError, zipfile.BadZipFile, AttributeError, TypeError, EOFError) as error:
        raise RecordingError(f"{path}: not a readable NPZ archive (truncated or of another kind): {error}") from None
    if not columns:
        raise RecordingError(f"{path}: is empty; expected arrays of shape (rows,) or (rows, n)")
    return [Recorded(str(path), columns)]


def _array(archive: np.lib.npyio.NpzFile, name: str) -> np.ndarray:
    """An array; one of Python objects, which is never loaded, counts as none."""
    try:
        return archive[name]
    except ValueError as error:
        if "allow_pickle" in str(error):
            return np.zeros(())
        raise

"""Episodes as a folder of pictures and a table of actions: what any program can write."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from datamodules.images.files import list_images, read_image
from datamodules.trajectories import Episode, TrajectoryFileError

ACTIONS = "actions.csv"
"""The table: a row for each control step, a column for each action; a first row of names may be there."""


def read_episode_folder(folder: Path) -> Episode:
    """An episode: pictures in the order of their names (2.png before 10.png), T+1 of them, and ``actions.csv``, T rows.

    Raises:
        TrajectoryFileError: naming the folder or file, what was expected and what came.
    """
    actions = read_action_table(folder / ACTIONS)
    try:
        files = sorted(list_images(folder), key=numbers_by_size)
        frames = [read_image(file) for file in files]
    except ValueError as error:
        raise TrajectoryFileError(str(error)) from None
    if len(frames) != len(actions) + 1:
        raise TrajectoryFileError(
            f"{folder}: {len(frames)} pictures and {len(actions)} actions; there must be one picture more: before the "
            "first action, and after each"
        )
    for file, frame in zip(files, frames, strict=True):
        if frame.shape != frames[0].shape:
            raise TrajectoryFileError(f"{file}: is {frame.shape}, and {files[0].name} is {frames[0].shape}")
    return Episode(actions, {"pixels": np.stack(frames)})


def read_action_table(path: Path) -> np.ndarray:
    """Actions float32 (T, nu).

    Raises:
        TrajectoryFileError: naming the file and row.
    """
    if not path.is_file():
        raise TrajectoryFileError(f"{path}: is missing; expected a row of numbers for each control step")
    _, rows = read_rows(path)
    if not rows:
        raise TrajectoryFileError(f"{path}: has no actions")
    for i, row in enumerate(rows, 1):
        if len(row) != len(rows[0]) or not all(map(is_finite_number, row)):
            raise TrajectoryFileError(f"{path}: action {i} is {','.join(row)}; expected {len(rows[0])} finite numbers")
    return np.array(rows, dtype=np.float32)


def read_action_names(path: Path) -> list[str]:
    """Names of the actions, from the first row; none where that has numbers."""
    return [name.strip() for name in read_rows(path)[0]]


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """A table's first row, if it is none of numbers, and the others."""
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if row]
    return (rows[0], rows[1:]) if rows and not is_finite_number(rows[0][0]) else ([], rows)


def numbers_by_size(path: Path) -> list[tuple[bool, int, str]]:
    """A key to sort by names, in which numbers come in their order, whether or not they have leading zeros."""
    return [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", str(path))]


def is_finite_number(text: str) -> bool:
    """Whether a cell is a finite number."""
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False

"""Frames of many simulations of one model at a time, by several processes."""

from __future__ import annotations

import functools
import multiprocessing
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import mujoco
import numpy as np

from idapt_pl.domains.rendering import make_renderer

POSES = (
    "xpos", "xquat", "xmat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "cam_xpos", "cam_xmat", "light_xpos",
    "light_xdir",
)  # fmt: skip
"""What a picture shows of ``MjData``."""


MOST = 3
"""Further processes by default, at most: each takes some 400 MB, and a step has few frames to share out."""


def usual_processes() -> int:
    """One for each core that this process may use but the one it runs on, within bounds."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(MOST, cores - 1)


class ParallelRenderer:
    """Renders the frames of several simulations of one model: a share here, the rest in other processes.

    Pictures are the same to the bit wherever they are rendered. Threads would not do: reading a frame back holds
    Python's lock. The processes are started by the first call that has something for them and kept until this one
    ends, since starting one takes seconds.

    Args:
        model: compiled model with the task's camera.
        size: height and width in pixels.
        processes: further processes at most; 0 renders everything here. With any, the main module must be importable
            without side effects (``if __name__ == "__main__"``), as always with :mod:`multiprocessing`.
    """

    def __init__(self, model: mujoco.MjModel, size: int, processes: int = 0) -> None:
        self._model, self._size, self._processes = model, size, processes
        self._own = make_renderer(model, size)
        self._folder: tempfile.TemporaryDirectory | None = None

    def __call__(self, data: Sequence[mujoco.MjData]) -> np.ndarray:
        """Render. Returns uint8 (n, size, size, 3)."""
        first, *others = np.array_split(np.arange(len(data)), min(len(data), self._processes + 1))
        frames = np.empty((len(data), self._size, self._size, 3), np.uint8)
        pending = [(share, self._submit([poses(data[i]) for i in share])) for share in others]
        for i in first:
            self._own(data[i], out=frames[i])
        for share, future in pending:
            frames[share] = future.result()
        return frames

    def _submit(self, seen: list[dict[str, np.ndarray]]):
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="idapt-")
            mujoco.mj_saveModel(self._model, str(self._path))
        return _processes(self._processes).submit(_render, str(self._path), self._size, seen)

    @property
    def _path(self) -> Path:
        return Path(self._folder.name) / "model.mjb"

    def close(self) -> None:
        """Free what this process renders with; the others keep theirs until they need the room."""
        self._own.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def poses(data: mujoco.MjData) -> dict[str, np.ndarray]:
    """What a picture shows of a simulation. Not recomputed from ``qpos``: after a step, ``MjData`` lags behind that."""
    return {name: getattr(data, name) for name in POSES}


@functools.cache
def _processes(number: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(number, multiprocessing.get_context("spawn"))


@functools.lru_cache(maxsize=4)
def _loaded(path: str, size: int) -> tuple[mujoco.MjData, object]:
    """In one of the processes: a model's renderer, and data to show."""
    model = mujoco.MjModel.from_binary_path(path)
    return mujoco.MjData(model), make_renderer(model, size)


def _render(path: str, size: int, seen: list[dict[str, np.ndarray]]) -> np.ndarray:
    """In one of the processes: frames, uint8 (n, size, size, 3)."""
    data, render = _loaded(path, size)
    frames = np.empty((len(seen), size, size, 3), np.uint8)
    for frame, values in zip(frames, seen, strict=True):
        for name, value in values.items():
            getattr(data, name)[:] = value
        render(data, out=frame)
    return frames

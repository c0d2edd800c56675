"""Frames of many simulations of one model at a time, by several processes."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from idapt_pl.effects.visual import engine_of
from idapt_pl.rendering.make import filament_is_used, make_renderer
from idapt_pl.rendering.process import RenderProcess
from idapt_pl.usable_cores import usable_cores

MOST_PROCESSES = 3
"""Further processes of an engine by default, at most: each takes some 300 MB, and steps have few frames to share."""
FRAMES_PER_PROCESS = 1500
"""Frames that a process draws before it is replaced where Filament draws, which keeps memory of every frame."""

_others: dict[str, list[RenderProcess]] = {"classic": [], "filament": []}
"""This program's processes by engine, kept until it ends, since starting one takes seconds. None draws by OpenGL and by
Vulkan: a driver may not bear both in one process."""


def usual_processes() -> int:
    """One for each core that this process may use but the one it runs on, within bounds."""
    return min(MOST_PROCESSES, usable_cores() - 1)


class BatchRenderer(Protocol):
    """Renders the frames of several simulations of one model."""

    def __call__(self, data: Sequence[mujoco.MjData]) -> np.ndarray:
        """Render. Returns uint8 (n, size, size, 3)."""

    def close(self) -> None:
        """Free what it renders with."""


class ParallelRenderer:
    """Renders the frames of several simulations of one model: a share here, the rest in other processes.

    Pictures are the same to the bit wherever they are rendered. Threads would not do: reading a frame back holds
    Python's lock. What Filament draws is all drawn in other processes, one at least, that are replaced now and then:
    it keeps memory of every frame until its process ends.

    Args:
        model: compiled model with the task's camera.
        size: height and width in pixels.
        processes: further processes at most; 0 renders everything here (Filament: in one other).
    """

    def __init__(self, model: mujoco.MjModel, size: int, processes: int = 0) -> None:
        self._model, self._size = model, size
        self._elsewhere = engine_of(model) == "filament" and filament_is_used()
        self._shares = processes + 1
        self._own = None if self._elsewhere else make_renderer(model, size)
        self._folder: tempfile.TemporaryDirectory | None = None

    def __call__(self, data: Sequence[mujoco.MjData]) -> np.ndarray:
        """Render. Returns uint8 (n, size, size, 3)."""
        shares = np.array_split(np.arange(len(data)), min(len(data), self._shares))
        own = np.arange(0) if self._elsewhere else shares.pop(0)
        frames = np.empty((len(data), self._size, self._size, 3), np.uint8)
        processes = self._processes(len(shares))
        try:
            for process, share in zip(processes, shares, strict=True):
                process.ask(self._file, self._size, [data[i] for i in share])
            if self._own is not None:
                for i in own:
                    self._own(data[i], out=frames[i])
            for process, share in zip(processes, shares, strict=True):
                process.answer(frames[share[0] : share[-1] + 1])
        except BaseException:  # what was asked for and not taken must not be taken for the next answer
            for process in processes:
                process.close()
            raise
        return frames

    def _processes(self, number: int) -> list[RenderProcess]:
        others = _others["filament" if self._elsewhere else "classic"]
        while len(others) < number:
            others.append(RenderProcess())
        for process in others[:number]:
            if self._elsewhere and process.drawn >= FRAMES_PER_PROCESS:
                process.close()
        return others[:number]

    @property
    def _file(self) -> Path:
        """The model, for other processes to read."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="idapt-")
            mujoco.mj_saveModel(self._model, str(Path(self._folder.name) / "model.mjb"))
        return Path(self._folder.name) / "model.mjb"

    def close(self) -> None:
        """Free what this process renders with; the others keep theirs until they need the room."""
        if self._own is not None:
            self._own.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

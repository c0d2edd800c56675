"""Commands as they arrive at the motors, averaged over each time step of a simulation."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from idapt_pl.effects.base import Effect
from idapt_pl.effects.runtime import Command, CommandEffect, mean_between
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.recent import RecentArrays

KEPT_COMMANDS = 2**25


class HeldCommands:
    """Recorded commands, through effects on commands.

    Commands are held, not interpolated, and averaged over each time step, so that delays and time stamps need not be
    multiples of it. Most effects act on one motor: the others' commands are averaged once.

    Args:
        model: the nominal one.
        data: the recordings.
        own: what the model's actuators do to commands themselves, after all other effects, for a time step [s].
    """

    def __init__(
        self, model: mujoco.MjModel, data: Sequence[Recording],
        own: Callable[[float], Sequence[CommandEffect]] = lambda step: (),
    ) -> None:  # fmt: skip
        self.model, self.data = model, data
        self.own = functools.cache(lambda step: for_many_at_once(own(step), model))
        self._kept = RecentArrays[np.ndarray](KEPT_COMMANDS)

    def averaged(self, effects: Sequence[Effect], windows: Windows, steps: int, h: float) -> np.ndarray:
        """Mean commands of each time step of length ``h``, (n, steps, nu); of ``effects`` those on commands count."""
        on_commands = tuple(e for e in effects if isinstance(e, CommandEffect))
        at = (steps, h, windows.start.tobytes(), windows.episode.tobytes())
        as_recorded = self._kept.get(((), *at), lambda: self._average((), range(self.model.nu), windows, steps, h))
        if not on_commands:
            return as_recorded

        def through_effects() -> np.ndarray:
            changed = sorted({i for e in on_commands for i in e.columns(self.model)})
            out = as_recorded.copy()
            out[..., changed] = self._average(on_commands, changed, windows, steps, h)
            return out

        return self._kept.get((on_commands, *at), through_effects)

    def at_samples(self, effects: Sequence[Effect]) -> list[np.ndarray]:
        """Mean command of the control step that begins at each sample of each recording, (T + 1, nu) each."""
        out = []
        for e, r in enumerate(self.data):
            every = Windows(np.full(len(r.time), e), np.arange(len(r.time)), np.zeros(1, int))
            out.append(self.averaged(effects, every, 1, float(np.median(np.diff(r.time))))[:, 0])
        return out

    def _average(
        self, effects: Sequence[CommandEffect], columns: Sequence[int], windows: Windows, steps: int, h: float
    ) -> np.ndarray:
        """Some of the commands: (n, steps, columns)."""
        columns = list(columns)
        out = np.zeros((len(windows), steps, len(columns)))
        for e in np.unique(windows.episode) if columns else ():
            record, rows = self.data[e], np.flatnonzero(windows.episode == e)
            command = Command(record.time, record.actions[:, columns])
            for effect, meant in (*((e, e.columns(self.model)) for e in as_they_act(effects)), *self.own(h)):
                of = [columns.index(i) for i in meant if i in columns]
                command = effect.transform(command, of, h) if of else command
            at = record.time[windows.start[rows], None] + h * np.arange(steps + 1)
            out[rows] = mean_between(command, at)
        return out


def as_they_act(effects: Sequence[CommandEffect]) -> list[CommandEffect]:
    """Effects in the order of the repaired model: delays and filters come last, whenever they were found.

    MuJoCo cuts commands off before its actuators' filters, and what MJCF has no words for acts on commands before both.
    """
    return sorted(effects, key=lambda e: isinstance(e, (ActuatorDelay, ActuatorLag)))


def for_many_at_once(effects: Sequence[CommandEffect], model: mujoco.MjModel) -> list[tuple[CommandEffect, list[int]]]:
    """Effects, and columns of the commands for each: one for all actuators that have the like, as most machines do."""
    alike = dict[CommandEffect, list[int]]()
    for effect in effects:
        alike.setdefault(replace(effect, target="*"), []).extend(effect.columns(model))
    return list(alike.items())

"""Laws in replayed windows: what they remember when a window begins comes from the recording before it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.linalg import solve_banded

from idapt_pl.effects.acting import ActingForces, MotionNow, joint_signals
from idapt_pl.effects.base import Effect
from idapt_pl.effects.learned import JointSignals
from idapt_pl.prediction.data import Recording, Windows
from idapt_pl.prediction.held_commands import HeldCommands


class LawsInWindows:
    """Laws that act in windows replayed side by side; asked for forces step by step.

    Args:
        model: that is simulated.
        recorded: whose coordinates the recordings have; the same, but for play in joints.
        effects: of which those with laws count, and what others do to commands.
        commands: of the recordings.
        windows: that begin now.
    """

    def __init__(
        self, model: mujoco.MjModel, recorded: mujoco.MjModel, effects: Sequence[Effect], commands: HeldCommands,
        windows: Windows,
    ) -> None:  # fmt: skip
        self.model, self.acting = model, ActingForces(model, effects)
        self.began = np.array([commands.data[e].time[0] for e in windows.episode])
        self.memory = np.zeros((len(windows), 0))
        if self.acting.memories:
            past = remembered(ActingForces(recorded, effects), commands.data, commands.at_samples(effects))
            self.memory = np.stack([past[e][k] for e, k in zip(windows.episode, windows.start, strict=True)])
        self.before: list[JointSignals] = []
        self.time = np.zeros(len(windows))

    def forces(self, states: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """What the laws add at the states reached (n, size), under these commands (n, nu): (n, nv)."""
        m = self.model
        if not self.acting.pairs:
            return np.zeros((len(states), m.nv))
        qpos, qvel, activation = np.split(states[:, 1:], [m.nq, m.nq + m.nv], 1)
        now = MotionNow(qpos, qvel, commands, activation[:, : m.na], states[:, 0] - self.began)
        signals = self.acting.signals(now)
        if self.before:
            self.memory = self.acting.remember(self.before, signals, self.memory, now.time - self.time)
        self.before, self.time = signals, now.time
        return self.acting.forces(signals, self.memory)


def remembered(acting: ActingForces, data: Sequence[Recording], commands: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What laws remember at every sample of every recording, from what was measured: (samples, memories) each.

    All are gone through at once, one after the other. ``commands``: as they arrive, of each recording, (T + 1, nu).
    """
    samples = [len(r.time) for r in data]
    time, q, v, u = (
        np.concatenate(each)
        for each in zip(
            *((r.time - r.time[0], r.qpos, r.qvel, c) for r, c in zip(data, commands, strict=True)), strict=True
        )
    )
    rows, goes_on = len(time), np.ones(len(time) - 1, bool)
    goes_on[np.cumsum(samples)[:-1] - 1] = False
    seconds = np.where(goes_on, np.diff(time), 1.0)
    seen = MotionNow(q, v, u, np.zeros((rows, acting.model.na)), time)
    every = [joint_signals(acting.model, j, seen, None, None) for _, j in acting.pairs]
    before: list[JointSignals] = [{name: x[:-1] for name, x in signals.items()} for signals in every]
    now: list[JointSignals] = [{name: x[1:] for name, x in signals.items()} for signals in every]
    # what laws remember after a step is linear in what they remembered before: kept · before + new
    nothing = np.zeros((rows - 1, acting.memories))
    new = acting.remember(before, now, nothing, seconds)
    kept = acting.remember(before, now, nothing + 1, seconds) - new
    kept[~goes_on], new[~goes_on] = 0.0, 0.0
    steps = np.zeros((2, acting.memories, rows))  # every memory in a row of its own, as one system of equations
    steps[0, :, :-1], steps[1, :, 1:] = kept.T, new.T
    bands = np.stack([np.ones(steps[0].size), -steps[0].ravel()])
    past = solve_banded((1, 0), bands, steps[1].ravel(), check_finite=False)
    return np.split(past.reshape(acting.memories, rows).T, np.cumsum(samples)[:-1])

"""Laws in replayed windows: what they remember when a window begins comes from the recording before it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

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
            self.memory = past[windows.episode, windows.start]
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


def remembered(acting: ActingForces, data: Sequence[Recording], commands: Sequence[np.ndarray]) -> np.ndarray:
    """What laws remember at every sample of every recording, from what was measured: (recordings, samples, memories).

    All are gone through side by side; the last sample of a shorter one is repeated. ``commands``: as they arrive, of
    each recording, (T + 1, nu).
    """
    samples = max(len(r) for r in data) + 1
    time, qpos, qvel, arriving = (
        np.stack([x[np.minimum(np.arange(samples), len(x) - 1)] for x in each])
        for each in zip(
            *((r.time - r.time[0], r.qpos, r.qvel, u) for r, u in zip(data, commands, strict=True)), strict=True
        )
    )
    rows = len(data) * samples
    q, v, u = (x.reshape(rows, x.shape[-1]) for x in (qpos, qvel, arriving))
    all_samples = MotionNow(q, v, u, np.zeros((rows, acting.model.na)), time.ravel())
    every = [joint_signals(acting.model, j, all_samples, None, None) for _, j in acting.pairs]
    seen = [{name: x.reshape(len(data), samples) for name, x in signals.items()} for signals in every]
    before: list[JointSignals] = [{name: x[:, :-1] for name, x in signals.items()} for signals in seen]
    now: list[JointSignals] = [{name: x[:, 1:] for name, x in signals.items()} for signals in seen]
    # what laws remember after a step is linear in what they remembered before: kept · before + new
    out = np.zeros((len(data), samples, acting.memories))
    new = acting.remember(before, now, np.zeros_like(out[:, 1:]), np.diff(time))
    kept = acting.remember(before, now, np.ones_like(out[:, 1:]), np.diff(time)) - new
    for k in range(samples - 1):
        out[:, k + 1] = kept[:, k] * out[:, k] + new[:, k]
    return out

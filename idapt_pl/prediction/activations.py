"""States of actuators where windows begin."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.effects.own_signals import commanded_activations, integrated_commands, integrators
from idapt_pl.prediction.data import Recording, Windows


class FirstActivations:
    """Of recordings. Integrators have come to where they are from where the recording began; made when asked for.

    Args:
        model: the nominal one.
        data: its recordings.
    """

    def __init__(self, model: mujoco.MjModel, data: Sequence[Recording]) -> None:
        self.model, self.data = model, data
        self._integrated: dict[int, np.ndarray] = {}

    def at(self, commands: np.ndarray, windows: Windows) -> np.ndarray:
        """Where windows begin, with these commands (n, nu): (n, na)."""
        out, at = commanded_activations(self.model, commands), self.model.actuator_actadr[integrators(self.model)]
        for e in np.unique(windows.episode) if len(at) else ():
            if e not in self._integrated:
                r = self.data[e]
                self._integrated[e] = integrated_commands(self.model, r.time, r.qpos, r.actions)
            rows = np.flatnonzero(windows.episode == e)
            out[np.ix_(rows, at)] = self._integrated[e][windows.start[rows]][:, at]
        return out

"""The state from readings and physics while a policy acts: a simulator runs along on the robot's computer."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from idapt_pl.modules import AsymmetricSAC
from idapt_pl.prediction.simulator import silence_mujoco
from idapt_pl.rl.policy import Acting
from idapt_pl.smoothing import EnsembleFilter, RecordingSmoother, SimulatedEnsemble


class ActingByPhysics(Acting):
    """A policy's head on what an ensemble of simulations makes of its readings, in place of its filter.

    Args:
        module: the policy; its encoder estimates states.
        physics: task, model, and how wrong readings are.
        seed: of the ensembles.

    Raises:
        ValueError: if the policy's features are no states.
    """

    def __init__(self, module: AsymmetricSAC, physics: RecordingSmoother, seed: int = 0) -> None:
        super().__init__(module, deterministic=True)
        if not module.supervised:
            raise ValueError("physics corrects readings of states, and this policy's encoder reads none")
        self.encoder = module.actor.encoder
        self.physics, self.seed = physics, seed
        self._lost = self._steps = 0
        self._filters: list[EnsembleFilter] = []
        self._played: list[np.ndarray | None] = []

    def _choose(self, features: Tensor) -> Tensor:
        units = (features * self.encoder.std + self.encoder.mean).double().cpu().numpy()
        while len(self._filters) < len(units):
            p = self.physics
            ensemble = SimulatedEnsemble(p.task, p.domain, p.members)
            seed = self.seed + len(self._filters)
            self._filters.append(EnsembleFilter(ensemble, p.expected, 0, seed, p.starts))
            self._played.append(None)
        with silence_mujoco():
            states = np.stack([self._estimate(i, reading) for i, reading in enumerate(units)])
        self.readings = features
        self.estimates = self.encoder.standardise(torch.from_numpy(states).float().to(features.device))
        return self.module.actor(self.estimates, deterministic=True)[0]

    def _estimate(self, i: int, reading: np.ndarray) -> np.ndarray:
        known, played = self._filters[i], self._played[i]
        known.begin_episode(reading) if played is None else known.play(played)
        self._lost += known.take_in(reading)[1]
        self._steps += 1
        return known.past[-1].mean(0)

    def played(self, actions: Tensor) -> None:
        """Remember the actions (n, nu) that were played, whoever chose them."""
        self._played = [a.astype(float) for a in actions.cpu().numpy()]

    @property
    def lost(self) -> float:
        """Share of the steps so far in which the ensemble lost the state."""
        return self._lost / max(1, self._steps)

    def tick(self, ended: np.ndarray) -> None:
        """A control step has passed; episodes that ended are forgotten."""
        for i in np.flatnonzero(ended[: len(self._played)]):
            self._played[i] = None

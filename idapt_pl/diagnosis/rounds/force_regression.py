"""A regression of forces: what damping, dry friction and rotor inertia say of the force that a model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from idapt_pl.diagnosis.candidates.fit import split_parameters
from idapt_pl.effects.base import names_in
from idapt_pl.effects.candidate import Candidate
from idapt_pl.prediction.force_windows import MeasuredMotion

Cause = tuple[Candidate, np.ndarray]
"""A candidate with its parameters, (p,)."""


@dataclass(frozen=True, eq=False)
class ForceRegression:
    """Forces that a model lacks in a motion; causes that rub or weigh are linear in their parameters.

    Attributes:
        model: the nominal one.
        motion: in n instants.
        lacking: generalised forces that it lacks there, (n, nv).
    """

    model: mujoco.MjModel
    motion: MeasuredMotion
    lacking: np.ndarray

    def dofs(self, target: str) -> list[int]:
        """Degrees of freedom of the joint, or of the two joints, that a target means."""
        names = names_in(target, [self.model.joint(j).name for j in range(self.model.njnt)])
        return [int(self.model.joint(name).dofadr[0]) for name in names]

    def changes(self, c: Candidate) -> np.ndarray:
        """Forces by each parameter of a candidate, (n, nv, p)."""
        own, turns = self.dofs(c.target), np.zeros(self.model.nv)  # how far each joint turns what rubs
        turns[own] = [getattr(c.effect(c.nominal), "ratio", 1.0), 1.0][-len(own) :]
        speed, acceleration = self.motion.qvel @ turns, self.motion.qacc @ turns
        does = {"damping": -speed, "frictionloss": -np.sign(speed), "armature": -acceleration}
        return np.stack([does[name][:, None] * turns for name in c.names], -1)

    def fit(self, candidates: Sequence[Candidate], size: np.ndarray | None = None) -> list[Cause]:
        """Candidates with values by least squares inside their bounds; none where nothing moves that they are on.

        ``size``: of what is left on each degree of freedom, which says how much each counts, (nv,); default all alike.
        """
        if not candidates:
            return []
        unit = np.ones(self.model.nv) if size is None else size
        columns = np.concatenate([self.changes(c) for c in candidates], -1) / unit[:, None]
        touched = np.abs(columns).any((0, 2))
        if not touched.any():
            return []
        A, y = columns[:, touched].reshape(-1, columns.shape[-1]), (self.lacking / unit)[:, touched].ravel()
        norm, nominal = np.linalg.norm(A, axis=0) + 1e-12, np.concatenate([c.nominal for c in candidates])
        low, high = (np.concatenate(ends) - nominal for ends in zip(*(c.bounds() for c in candidates), strict=True))
        found = lsq_linear(A / norm, y, (low * norm - 1e-12, high * norm + 1e-12))
        return list(zip(candidates, split_parameters(candidates, nominal + found.x / norm), strict=True))

    def left(self, causes: Sequence[Cause]) -> np.ndarray:
        """Forces that causes leave, (n, nv)."""
        return self.lacking - sum(
            (self.changes(c) @ (x - np.array(c.nominal)) for c, x in causes), np.zeros_like(self.lacking)
        )

"""Which components of a state vector are a model's positions and velocities, found by trying."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

TRIES = 12
"""States that are compared."""

TRIED_SPREAD = 0.1
"""Of the positions and velocities that are tried, m and rad, about where the model begins."""

EXACT = 1e-9
"""Two numbers that agree to this are taken to be the same."""


@dataclass(frozen=True)
class ToldMotion:
    """Where a state vector tells positions and velocities.

    Attributes:
        positions: for each position, the component that it is, or those of its cosine and sine; None if it is not told
            and nothing depends on it.
        velocities: for each velocity, the component that it is.
    """

    positions: tuple[int | tuple[int, int] | None, ...]
    velocities: tuple[int, ...]

    @property
    def rates(self) -> dict[int, int]:
        """State component to the component that it is the rate of change of."""
        pairs = zip(self.velocities, self.positions, strict=True)
        return {rate: position for rate, position in pairs if isinstance(position, int)}

    def motion(self, states: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions (T+1, nq) and velocities (T+1, nv) along states (T+1, s), ``period`` s apart.

        What is not told is integrated from its rate, from 0.
        """
        qvel = states[:, list(self.velocities)]
        columns = []
        for where, rate in zip(self.positions, qvel.T, strict=True):
            if where is None:
                columns.append(np.concatenate([[0.0], np.cumsum(rate[1:] + rate[:-1]) * period / 2]))
            elif isinstance(where, int):
                columns.append(states[:, where])
            else:
                columns.append(np.unwrap(np.arctan2(states[:, where[1]], states[:, where[0]])))
        return np.column_stack(columns), qvel


def find_told_motion(
    model: mujoco.MjModel, state: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray], start: mujoco.MjData
) -> ToldMotion | None:
    """What a state vector tells, or None if it does not tell all that matters.

    Positions and velocities are drawn about ``start``; a component that agrees in all of them is one. Models with
    ball or free joints are not understood.

    Args:
        model: of the source.
        state: the state vector of a simulation.
        start: a simulation at the start of an episode; it is moved about.
    """
    if model.nq != model.nv or not model.nv:
        return None
    rng, begin = np.random.default_rng(0), start.qpos.copy()
    qpos = begin + TRIED_SPREAD * rng.normal(size=(TRIES, model.nq))
    qvel = TRIED_SPREAD * rng.normal(size=(TRIES, model.nv))
    states = np.array([_put(model, start, q, v, state) for q, v in zip(qpos, qvel, strict=True)])
    velocities = [_same(states, column) for column in qvel.T]
    positions: list[int | tuple[int, int] | None] = []
    for j, column in enumerate(qpos.T):
        cosine, sine, itself = (_same(states, f(column)) for f in (np.cos, np.sin, np.asarray))
        if itself is not None:
            positions.append(itself)
        elif cosine is not None and sine is not None:
            positions.append((cosine, sine))
        elif _matters(model, start, qpos[0], qvel[0], j, state):
            return None
        else:
            positions.append(None)
    told = [v for v in velocities if v is not None]
    return ToldMotion(tuple(positions), tuple(told)) if len(told) == model.nv else None


def unseen_joints(model: mujoco.MjModel, told: ToldMotion) -> tuple[str, ...]:
    """Joints whose positions no state tells."""
    return tuple(model.joint(model.dof_jntid[i]).name for i, position in enumerate(told.positions) if position is None)


def flat_state(parts: Mapping[str, np.ndarray] | np.ndarray) -> np.ndarray:
    """An observation, an array or several by name, as one vector, float64."""
    if isinstance(parts, Mapping):
        return np.concatenate([np.ravel(parts[name]).astype(float) for name in parts])
    return np.ravel(parts).astype(float)


def _put(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    qvel: np.ndarray,
    state: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray],
) -> np.ndarray:
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    return state(model, data).copy()


def _same(states: np.ndarray, wanted: np.ndarray) -> int | None:
    """The component of states (n, s) that is ``wanted`` (n,)."""
    found = np.flatnonzero(np.abs(states - wanted[:, None]).max(0) < EXACT)
    return int(found[0]) if len(found) else None


def _matters(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    qvel: np.ndarray,
    j: int,
    state: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray],
) -> bool:
    """Whether state or acceleration depend on position j."""
    before, acceleration = _put(model, data, qpos, qvel, state), data.qacc.copy()
    moved = qpos.copy()
    moved[j] += 1.0
    after = _put(model, data, moved, qvel, state)
    return not (np.allclose(before, after, atol=1e-6) and np.allclose(acceleration, data.qacc, rtol=1e-4, atol=1e-4))

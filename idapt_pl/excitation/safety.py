"""Whether a predicted motion keeps its limits, and by how much."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.effects.candidate import scalar_joints
from idapt_pl.excitation.limits import MotionLimits
from idapt_pl.prediction.rolling import STATE

Pair = tuple[int, int]
"""Two geoms, by number."""


@dataclass(frozen=True)
class SafetyMargin:
    """The tightest place of a motion in one respect.

    Attributes:
        what: ``position shoulder``, for example.
        reached: the most extreme value.
        limit: what it may be.
        room: what is left, as a share of the limit's size; negative where it is exceeded.
    """

    what: str
    reached: float
    limit: float
    room: float

    def to_dict(self) -> dict:
        """As in ``next.json``."""
        return {"what": self.what, "reached": self.reached, "limit": self.limit, "room": self.room}


def span_excess(values: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """By how much values (n, T, k) go beyond spans (k, 2), in units of the spans' sizes, (n, k); negative inside."""
    size = np.where(np.isfinite(spans).all(1), spans[:, 1] - spans[:, 0], np.abs(spans).min(1))
    size = np.where(np.isfinite(size), np.maximum(size, 1e-9), 1.0)
    values = np.nan_to_num(values, nan=1e6, posinf=1e6, neginf=-1e6)
    return np.maximum(values.max(1) - spans[:, 1], spans[:, 0] - values.min(1)) / size


def motion_excess(model: mujoco.MjModel, limits: MotionLimits, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """The worst excess of positions and speeds of motions, (n,), from (n, T, nq) and (n, T, nv)."""
    q, v = scalar_addresses(model)
    turns = span_excess(qpos[..., q], limits.position[v])
    speeds = span_excess(qvel, np.stack([-limits.velocity, limits.velocity], 1))
    return np.concatenate([turns, speeds], 1).max(1)


def relative_size(model: mujoco.MjModel, limits: MotionLimits, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """How large motions (n, T, nq), (n, T, nv) are beside the largest that limits of position and speed allow, (n,).

    Positions count from where the motions start.
    """
    q, v = scalar_addresses(model)
    moved, room = qpos[..., q] - qpos[:, :1, q], limits.position[v][None, None] - qpos[:, :1, q, None]
    ways = np.where(moved > 0, room[..., 1], room[..., 0])
    turns = np.nan_to_num(moved / np.where(ways == 0, 1e-9, ways), nan=1e6, posinf=1e6)
    speeds = np.nan_to_num(np.abs(qvel) / limits.velocity, nan=1e6, posinf=1e6)
    return np.concatenate([turns, speeds], -1).max((1, 2), initial=0.0)


def scalar_addresses(model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Where positions and velocities of hinges and slides are."""
    joints = scalar_joints(model)
    return [int(model.jnt_qposadr[j]) for j, _, _ in joints], [v for _, v, _ in joints]


class PoseCheck:
    """Looks at single states of a motion: contacts, heights, forces.

    Args:
        model: that goes through them.
        limits: to keep.
    """

    def __init__(self, model: mujoco.MjModel, limits: MotionLimits) -> None:
        self.model, self.limits, self.data = model, limits, mujoco.MjData(model)
        self.moving = np.flatnonzero(moving_geoms(model))
        solid = bool(model.npair or (model.geom_contype | model.geom_conaffinity).any())
        self.needed = bool(
            (limits.no_contact and solid) or limits.lowest is not None or np.isfinite(limits.force).any()
        )

    def _pose(self, state: np.ndarray, command: np.ndarray) -> mujoco.MjData:
        """Where a state puts the model; with those of its filters and delays, on which forces depend."""
        d = self.data
        mujoco.mj_resetData(self.model, d)
        mujoco.mj_setState(self.model, d, state, STATE)
        d.ctrl[:] = command
        mujoco.mj_forward(self.model, d)
        return d

    def touching(self, data: mujoco.MjData) -> set[Pair]:
        """Pairs of geoms that touch."""
        return {(int(min(pair)), int(max(pair))) for pair in data.contact.geom[data.contact.dist < 0]}

    def forbidden(self, states: np.ndarray, arriving: np.ndarray) -> list[SafetyMargin]:
        """The tightest places of one motion; what touches at its start may go on touching.

        Args:
            states: ``mjSTATE_FULLPHYSICS``, (T+1, size).
            arriving: commands that act from each on, (T+1, nu).
        """
        if not self.needed:
            return []
        touched: set[Pair] = set()
        height, force = np.inf, np.tile([np.inf, -np.inf], (self.model.nu, 1))
        allowed = self.touching(self._pose(states[0], arriving[0]))
        for state, command in zip(states, arriving, strict=True):
            d = self._pose(state, command)
            touched |= self.touching(d) - allowed
            height = min(height, lowest_point(self.model, d, self.moving))
            force[:, 0] = np.minimum(force[:, 0], d.actuator_force)
            force[:, 1] = np.maximum(force[:, 1], d.actuator_force)
        return [*self._contacts(touched), *self._height(height), *self._forces(force)]

    def _contacts(self, touched: set[Pair]) -> list[SafetyMargin]:
        if not self.limits.no_contact:
            return []
        named = sorted(" and ".join(geom_name(self.model, g) for g in pair) for pair in touched)
        what = f"contact of {named[0]}" if named else "contacts"
        return [SafetyMargin(what, float(len(touched)), 0.0, 0.0 - len(touched))]

    def _height(self, height: float) -> list[SafetyMargin]:
        lowest = self.limits.lowest
        return [] if lowest is None else [SafetyMargin("height", height, lowest, height - lowest)]

    def _forces(self, force: np.ndarray) -> list[SafetyMargin]:
        found = []
        for i in np.flatnonzero(np.isfinite(self.limits.force).all(1)):
            found.append(tightest(f"force {self.model.actuator(i).name}", force[i], self.limits.force[i]))
        return found


def tightest(what: str, values: np.ndarray, span: np.ndarray) -> SafetyMargin:
    """The end of a span that values come closest to, or go beyond."""
    size = span[1] - span[0] if np.isfinite(span).all() else float(np.abs(span[np.isfinite(span)]).max() or 1.0)
    above, below = span[1] - values.max(), values.min() - span[0]
    if above < below:
        return SafetyMargin(what, float(values.max()), float(span[1]), float(above / size))
    return SafetyMargin(what, float(values.min()), float(span[0]), float(below / size))


def limit_margins(
    model: mujoco.MjModel, limits: MotionLimits, qpos: np.ndarray, qvel: np.ndarray
) -> list[SafetyMargin]:
    """Tightest positions and speeds of one motion, (T+1, nq) and (T+1, nv), joint by joint where there are limits."""
    found, addresses = [], scalar_joints(model)
    for j, v, name in addresses:
        if np.isfinite(limits.position[v]).any():
            found.append(tightest(f"position {name}", qpos[:, model.jnt_qposadr[j]], limits.position[v]))
        if np.isfinite(limits.velocity[v]):
            span = np.array([-limits.velocity[v], limits.velocity[v]])
            found.append(tightest(f"velocity {name}", qvel[:, v], span))
    return found


def moving_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Whether some joint moves each geom, (ngeom,)."""
    moved = np.zeros(model.nbody, bool)
    for b in range(1, model.nbody):  # a parent comes before its children
        moved[b] = bool(model.body_dofnum[b]) or moved[model.body_parentid[b]]
    return moved[model.geom_bodyid]


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> float:
    """Height of the lowest corner of the geoms' bounding boxes, m."""
    if not len(geoms):
        return np.inf
    up = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]  # the world's z in each geom's frame
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    return float((data.geom_xpos[geoms, 2] + (up * middle).sum(1) - (np.abs(up) * half).sum(1)).min())


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """A geom's name, or that of its body."""
    return model.geom(geom).name or model.body(model.geom_bodyid[geom]).name or f"geom {geom}"

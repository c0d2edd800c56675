"""What has to be done to a recording to take deployment faults out of it, as values, and how it is done.

Two faults are of the model rather than of the recording (drives of another kind, gravity along another axis);
:mod:`~idapt_pl.deployment_faults.model_mend` takes them out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.prediction.data import measured_signals

Numbers = tuple[float, ...]
Indices = tuple[int, ...]
Drive = tuple[float, float, float]
"""What drives a joint: gain of the command, of the position and of the velocity."""
Number = TypeVar("Number", int, float)

SHORTEST_LEFT = 5
"""Control steps that a shift must leave of every episode."""


@dataclass(frozen=True)
class Mend:
    """A change of recorded channels, into what the model calls them.

    A channel of the mended recording is ``scale * recorded[order] + offset``, taken ``late`` control steps earlier.

    Attributes:
        q_order, q_scale, q_offset: of positions, (nq,) each; offsets in the model's units.
        v_order, v_scale, v_late: of velocities, (nv,) each.
        u_order, u_scale, u_late: of commands, (nu,) each; those with ``u_late`` 2 act two steps after they were noted.
        period: factor on the control period and on time stamps.
        drives: of actuators that are of another kind than in the model, None for the others; empty where none is.
        gravity: in place of the model's [m/s²], (3,); None where that is right.
    """

    q_order: Indices
    q_scale: Numbers
    q_offset: Numbers
    v_order: Indices
    v_scale: Numbers
    v_late: Indices
    u_order: Indices
    u_scale: Numbers
    u_late: Indices
    period: float = 1.0
    drives: tuple[Drive | None, ...] = ()
    gravity: Numbers | None = None

    @classmethod
    def nothing(cls, model: mujoco.MjModel) -> Mend:
        """The mend of a recording without faults."""
        q, v, u = (tuple(range(n)) for n in (model.nq, model.nv, model.nu))
        one = [(1.0,) * len(x) for x in (q, v, u)]
        return cls(q, one[0], (0.0,) * len(q), v, one[1], (0,) * len(v), u, one[2], (0,) * len(u))

    # --- further changes, counted in the model's channels ------------------------------------------------

    def scaled_joint(self, joints: ScalarJoints, j: int, factor: float) -> Mend:
        """Position and velocity of a joint multiplied."""
        return self.scaled_position(joints, j, factor).scaled_velocity(joints, j, factor)

    def scaled_position(self, joints: ScalarJoints, j: int, factor: float) -> Mend:
        """A joint's position multiplied."""
        q = joints.q[j]
        scale, offset = self.q_scale[q] * factor, self.q_offset[q] * factor
        return replace(self, q_scale=put(self.q_scale, q, scale), q_offset=put(self.q_offset, q, offset))

    def scaled_velocity(self, joints: ScalarJoints, j: int, factor: float) -> Mend:
        """A joint's velocity multiplied."""
        v = joints.v[j]
        return replace(self, v_scale=put(self.v_scale, v, self.v_scale[v] * factor))

    def moved_joint(self, joints: ScalarJoints, j: int, by: float) -> Mend:
        """Something added to a joint's position."""
        q = joints.q[j]
        return replace(self, q_offset=put(self.q_offset, q, self.q_offset[q] + by))

    def ordered_positions(self, joints: ScalarJoints, order: Sequence[int]) -> Mend:
        """Positions of the joints taken from those of others: joint j from ``order[j]``."""
        return replace(
            self,
            q_order=rearranged(self.q_order, joints.q, order),
            q_scale=rearranged(self.q_scale, joints.q, order),
            q_offset=rearranged(self.q_offset, joints.q, order),
        )

    def ordered_velocities(self, joints: ScalarJoints, order: Sequence[int]) -> Mend:
        """Likewise their velocities."""
        return replace(
            self,
            v_order=rearranged(self.v_order, joints.v, order),
            v_scale=rearranged(self.v_scale, joints.v, order),
            v_late=rearranged(self.v_late, joints.v, order),
        )

    def ordered_joints(self, joints: ScalarJoints, order: Sequence[int]) -> Mend:
        """Positions and velocities of the joints taken from those of others."""
        return self.ordered_positions(joints, order).ordered_velocities(joints, order)

    def ordered_commands(self, order: Sequence[int]) -> Mend:
        """Commands of the actuators taken from those of others."""
        every = range(len(self.u_order))
        return replace(
            self,
            u_order=rearranged(self.u_order, every, order),
            u_scale=rearranged(self.u_scale, every, order),
            u_late=rearranged(self.u_late, every, order),
        )

    def scaled_command(self, i: int, factor: float) -> Mend:
        """An actuator's commands multiplied."""
        return replace(self, u_scale=put(self.u_scale, i, self.u_scale[i] * factor))

    def delayed_commands(self, late: Sequence[int]) -> Mend:
        """Commands moved by so many control steps each, (nu,)."""
        return replace(self, u_late=tuple(a + int(b) for a, b in zip(self.u_late, late, strict=True)))

    # --- and what it does --------------------------------------------------------------------------------

    @property
    def margins(self) -> tuple[int, int]:
        """Control steps that shifts cost at the start and at the end of each episode."""
        late = (0, *self.v_late, *self.u_late)
        return max(late), -min(late)

    def apply(self, model: mujoco.MjModel, data: Trajectories) -> Trajectories:
        """The mended recording.

        Raises:
            UnusableData: the recording does not fit the model.
            ValueError: an episode is too short for a shift.
        """
        episodes = tuple(self._apply(model, f"episode_{i}", e) for i, e in enumerate(data))
        return replace(data, episodes=episodes, dt=data.dt * self.period)

    def _apply(self, model: mujoco.MjModel, where: str, episode: Episode) -> Episode:
        qpos, qvel = measured_signals(model, where, episode)
        first, lost = self.margins
        last = len(episode) - lost
        if last - first < SHORTEST_LEFT and (first or lost):
            raise ValueError(f"{where}: {len(episode)} steps are too few to shift channels by {max(first, lost)}")
        seen = {k: a[first : last + 1] for k, a in episode.observations.items()}
        q = np.asarray(qpos, float)[:, list(self.q_order)] * self.q_scale + self.q_offset
        made = {"qpos": q[first : last + 1]}
        if qvel is not None:
            v = np.asarray(qvel, float)[:, list(self.v_order)] * self.v_scale
            made["qvel"] = shifted(v, self.v_late, first, last + 1)
        if "qpos" not in seen:
            seen.pop("state", None)
        u = np.asarray(episode.actions, float)[:, list(self.u_order)] * self.u_scale
        cut = {k: a if a is None else a[first:last] for k, a in per_step(episode).items()}
        stamps = episode.timestamps
        return replace(
            episode,
            actions=shifted(u, self.u_late, first, last).astype(np.float32),
            observations=seen | made,
            timestamps=None if stamps is None else stamps[first : last + 1] * self.period,
            infos={k: a[first : last + (len(a) > len(episode))] for k, a in episode.infos.items()},
            **cut,
        )


def per_step(episode: Episode) -> dict[str, np.ndarray | None]:
    """What an episode has for each control step beside its actions."""
    return {name: getattr(episode, name) for name in ("rewards", "terminations", "truncations")}


def shifted(channels: np.ndarray, late: Sequence[int], first: int, last: int) -> np.ndarray:
    """Rows ``first`` to ``last`` (excluded) of channels, each taken ``late`` rows earlier, (last - first, n)."""
    columns = [channels[first - s : last - s, i] for i, s in enumerate(late)]
    return np.stack(columns, 1) if columns else channels[first:last]


def put(values: tuple[Number, ...], i: int, value: Number) -> tuple[Number, ...]:
    """Values with one of them replaced."""
    out = list(values)
    out[i] = value
    return tuple(out)


def rearranged(values: tuple[Number, ...], at: Sequence[int], order: Sequence[int]) -> tuple[Number, ...]:
    """Values where those ``at`` some places are taken from others of these places, by number among them."""
    out = list(values)
    for place, source in zip(at, order, strict=True):
        out[place] = values[at[source]]
    return tuple(out)

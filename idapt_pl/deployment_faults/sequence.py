"""Samples that are lost, out of order or not there yet, by positions that do not follow from velocities.

No model is needed: over a control step positions change by the mean velocity times the period. Where a row is missing
they change by twice that; where two rows are exchanged they go forth, back and forth; first rows that are no
measurements (zeros before the first message) are the same in all episodes, and do not lead to the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.estimation.robust import robust_deviation
from idapt_pl.prediction.data import LEFT_OUT, measured_signals

MOST_LOST = 4
"""Rows lost in a row that are told from one step."""

FAR_FROM_USUAL = 8.0
"""Usual mismatches of positions and velocities beyond which a step is none of one control period."""

MUCH_CLOSER = 0.25
"""Share of the mismatch that is left where another explanation is right."""

FEWEST_FOUND = 3
"""Rows that are worth a word."""

MOST_FIRST = 5
"""Rows at the start of an episode that may be no measurements."""


@dataclass(frozen=True)
class SequenceFaults:
    """What is wrong with the rows of a recording.

    Attributes:
        lost: of each episode, how many rows are missing after each row, (T,).
        swapped: of each episode, rows that are exchanged with the next one.
        first: of each episode, how many rows at its start are no measurements.
    """

    lost: tuple[np.ndarray, ...]
    swapped: tuple[tuple[int, ...], ...]
    first: tuple[int, ...]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Rows lost, pairs exchanged, episodes with wrong first rows; 0 where there are too few for a word."""
        lost, swapped = sum(int(x.sum()) for x in self.lost), sum(map(len, self.swapped))
        started = sum(f > 0 for f in self.first)
        enough = started >= max(2, len(self.first) / 2)
        return lost * (lost >= FEWEST_FOUND), swapped * (swapped >= FEWEST_FOUND), started * enough


def find_sequence_faults(model: mujoco.MjModel, data: Trajectories) -> SequenceFaults:
    """Look at every episode; nothing is found where velocities were not measured or time stamps tell the time."""
    joints = ScalarJoints.of(model)
    lost, swapped, first = list[np.ndarray](), list[tuple[int, ...]](), list[int]()
    channels = [channels_of_episode(model, i, e, joints) for i, e in enumerate(data)]
    usual, alike = usual_mismatch(channels, data.dt), rows_alike([c for c in channels if c is not None])
    begins = rows_before_first(channels, data.dt, usual, alike)
    for c, begin in zip(channels, begins, strict=True):
        found, missing = tuple[int, ...](), np.zeros(0, int)
        if c is not None and usual is not None:
            found = swapped_rows(c, data.dt, usual)
            explained = {*found, *(k + d for k in found for d in (-1, 1)), *range(begin)}
            missing = lost_rows(c, data.dt, usual, explained)
        lost.append(missing)
        swapped.append(found)
        first.append(begin)
    return SequenceFaults(tuple(lost), tuple(swapped), tuple(first))


JointMotion = tuple[np.ndarray, np.ndarray]
"""Positions and velocities of hinges and slides, (T+1, n) each."""


def channels_of_episode(
    model: mujoco.MjModel, number: int, episode: Episode, joints: ScalarJoints
) -> JointMotion | None:
    """Positions and velocities; None where velocities or regular samples are missing."""
    qpos, qvel = measured_signals(model, f"episode_{number}", episode)
    if qvel is None or not len(joints) or len(episode) < 8 or episode.timestamps is not None:
        return None
    return np.asarray(qpos, float)[:, list(joints.q)], np.asarray(qvel, float)[:, list(joints.v)]


def mismatch(motion: JointMotion, dt: float, rows: np.ndarray | None = None, periods: float = 1.0) -> np.ndarray:
    """Change of the positions beyond what the mean velocity makes, of steps from ``rows`` on, (rows, n)."""
    q, v = motion
    k = np.arange(len(q) - 1) if rows is None else rows
    return q[k + 1] - q[k] - periods * dt * (v[k] + v[k + 1]) / 2


def usual_mismatch(channels: list[JointMotion | None], dt: float) -> np.ndarray | None:
    """Of each joint, (n,); None where nothing can be compared, or velocities and positions do not agree at all."""
    every = [mismatch(c, dt) for c in channels if c is not None]
    if not every or not np.isfinite(dt) or dt <= 0:
        return None
    both, moved = np.concatenate(every), np.concatenate([np.diff(c[0], axis=0) for c in channels if c is not None])
    usual = robust_deviation(both) + 1e-9
    agree = np.median(np.abs(both), 0) < 0.3 * np.median(np.abs(moved), 0) + 1e-12
    return np.where(agree, usual, np.inf) if agree.any() else None


def size(off: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """Mismatches (rows, n) in usual ones, of the worst joint, (rows,)."""
    return np.abs(off / usual).max(1)


def lost_rows(motion: JointMotion, dt: float, usual: np.ndarray, taken: set[int]) -> np.ndarray:
    """How many rows are missing after each row, (T,): the steps beside such a step are as usual.

    Where a filter of the velocities has just begun, they lag for many steps, by less and less.

    Args:
        motion: of the episode.
        dt: control period, s.
        usual: mismatch of each joint, (n,).
        taken: rows that are explained otherwise.
    """
    one, found = size(mismatch(motion, dt), usual), np.zeros(len(motion[0]) - 1, int)
    for k in np.flatnonzero(one > FAR_FROM_USUAL).tolist():
        if k in taken or (one[max(k - 1, 0) : k + 2] > FAR_FROM_USUAL).sum() > 1:
            continue
        rows = np.array([k])
        left = [float(size(mismatch(motion, dt, rows, 1.0 + m), usual)[0]) for m in range(1, MOST_LOST + 1)]
        best = int(np.argmin(left))
        # what changes within the lost time leaves more than usual
        if left[best] < max(MUCH_CLOSER * one[k], 3.0):
            found[k] = best + 1
    return found


def swapped_rows(motion: JointMotion, dt: float, usual: np.ndarray) -> tuple[int, ...]:
    """Rows that are exchanged with the next one: exchanged back, three steps agree that did not."""
    q, v = motion
    off = size(mismatch(motion, dt), usual)
    found: list[int] = []
    for k in range(1, len(q) - 2):
        three = off[k - 1 : k + 2]
        if three.max() < FAR_FROM_USUAL or (three > 3.0).sum() < 2 or (found and k - found[-1] < 2):
            continue
        order = np.array([k - 1, k + 1, k, k + 2])
        back = size(mismatch((q[order], v[order]), dt), usual)
        if back.max() < max(MUCH_CLOSER * three.max(), 3.0):
            found.append(k)
    return tuple(found)


def rows_alike(channels: list[JointMotion]) -> np.ndarray:
    """The first rows that most episodes have in common, to the last bit, as no measurements are: (rows, 2 n)."""
    firsts = [np.concatenate([q[:MOST_FIRST], v[:MOST_FIRST]], 1) for q, v in channels]
    if len(firsts) < 2:
        return np.zeros((0, 0))
    common = np.median(np.stack(firsts), 0)
    same = np.mean([(f == common).all(1) for f in firsts], 0) > 0.5
    return common[: int(np.argmin(same)) if not same.all() else len(same)]


def rows_before_first(
    channels: list[JointMotion | None], dt: float, usual: np.ndarray | None, alike: np.ndarray
) -> list[int]:
    """Of each episode, rows at its start that are no measurements; 0 for all where that is not certain.

    Episodes begin with them alike, and in half of these at least they do not lead to the next row.

    Args:
        channels: of each episode.
        dt: control period, s.
        usual: mismatch of each joint, (n,).
        alike: first rows that episodes have in common, (rows, 2 n).
    """
    n = len(alike)
    begun = [c is not None and np.array_equal(np.concatenate([x[:n] for x in c], 1), alike) for c in channels]
    if not n or usual is None:
        return [0] * len(channels)
    last = np.array([n - 1])
    off = [size(mismatch(c, dt, last), usual)[0] for c, b in zip(channels, begun, strict=True) if b and c is not None]
    certain = len(off) >= 2 and np.mean(np.array(off) > FAR_FROM_USUAL) >= 0.5
    return [n * (b and bool(certain)) for b in begun]


# --- and what is done about it --------------------------------------------------------------------------


def without_sequence_faults(data: Trajectories, faults: SequenceFaults) -> Trajectories:
    """The recording with rows in order, time stamps that tell of lost rows, and without rows before the first one."""
    lost, swapped, started = faults.counts
    mend: list[Callable[[Episode, int], Episode]] = []
    if swapped:
        mend.append(lambda e, i: with_rows_in_order(e, faults.swapped[i]))
    if lost:
        mend.append(lambda e, i: with_lost_time(e, faults.lost[i], data.dt))
    if started:
        mend.append(lambda e, i: from_row(e, faults.first[i]))
    episodes = list(data.episodes)
    for step in mend:
        episodes = [step(e, i) for i, e in enumerate(episodes)]
    return replace(data, episodes=tuple(episodes))


def with_rows_in_order(episode: Episode, swapped: tuple[int, ...]) -> Episode:
    """An episode whose measurements are exchanged back."""
    order = np.arange(len(episode) + 1)
    for k in swapped:
        order[[k, k + 1]] = order[[k + 1, k]]
    return replace(episode, observations={name: a[order] for name, a in episode.observations.items()})


def with_lost_time(episode: Episode, lost: np.ndarray, dt: float) -> Episode:
    """An episode with time stamps; the steps in which rows are missing are left out, as their commands are."""
    if not lost.any():
        return episode
    time = np.concatenate([[0.0], np.cumsum(dt * (1 + lost))])
    marked = np.asarray(episode.infos.get(LEFT_OUT, np.zeros(len(episode), bool)), bool) | (lost > 0)
    return replace(episode, timestamps=time, infos=episode.infos | {LEFT_OUT: marked})


def from_row(episode: Episode, first: int) -> Episode:
    """An episode without its first rows."""
    if not first:
        return episode

    def cut(a: np.ndarray | None) -> np.ndarray | None:
        return None if a is None else a[first:]

    stamps = episode.timestamps
    return Episode(
        episode.actions[first:],
        {name: a[first:] for name, a in episode.observations.items()},
        cut(episode.rewards), cut(episode.terminations), cut(episode.truncations),
        None if stamps is None else stamps[first:] - stamps[first],
        {name: a[first:] if len(a) >= len(episode) else a for name, a in episode.infos.items()},
    )  # fmt: skip

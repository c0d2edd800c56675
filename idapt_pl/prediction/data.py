"""Measured episodes, checked against the model, and the short windows they are compared in."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from datamodules import Episode, Trajectories
from idapt_pl.effects.contacts import touching_geoms
from idapt_pl.effects.signals import FILTERS

log = logging.getLogger(__name__)


class UnusableData(ValueError):
    """A recording does not fit the model, or cannot be used; the message says where and why."""


LATEST_VELOCITIES = 0.5
"""Measured velocities that lag the positions by more control periods than this are not used."""

SLOPE_HALF_WIDTH = 0.01
"""Velocities that were not measured are slopes of the positions over about this time to either side [s]."""

LONGEST_PAUSE = 10.0
"""Seconds between two rows, for which one command is simulated; more is no recording of them."""

JUMP = 12.0
"""A velocity jumps where its second difference is so many times the usual one."""
SHARE_OF_IMPACTS, FEWEST_WINDOWS = 1 / 3, 60
"""Of the windows, where impacts are rarer; but not fewer windows than this for it."""
LEFT_OUT = "left_out"
"""Name of the channel of ``infos`` that marks control steps in which the model is not expected to hold."""

START_UP, TIME_CONSTANTS = 0.25, 8.0
"""Seconds at the start of an episode in which commands from before it may still act, delayed or filtered.

Or so many time constants of the model's slowest actuator: what its filter held then is not known."""


@dataclass(frozen=True)
class Recording:
    """One episode as the diagnosis sees it.

    Attributes:
        name: for messages, for example ``episode_3``.
        time: s, (T+1,).
        qpos: measured positions, (T+1, nq).
        qvel: measured or estimated velocities, (T+1, nv).
        actions: commands, (T, nu), held from ``time[k]`` to ``time[k + 1]``.
        left_out: control steps that nothing is predicted in, (T,) bool; None for none.
        impacts: whether something hit something between a sample and the next, (T,); None where it is not known.
        start_up: how long commands from before may act, s.
    """

    name: str
    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    actions: np.ndarray
    left_out: np.ndarray | None = None
    impacts: np.ndarray | None = None
    start_up: float = START_UP

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class Windows:
    """Short stretches of recordings, all with the same number of samples.

    Attributes:
        episode: which recording each window lies in, (n,).
        start: its first sample, (n,).
        offsets: samples compared with the prediction, counted from the first one, (j,).
    """

    episode: np.ndarray
    start: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: np.ndarray) -> Windows:
        return Windows(self.episode[rows], self.start[rows], self.offsets)


def as_recordings(model: mujoco.MjModel, data: Trajectories, may_lag: bool = True) -> tuple[list[Recording], bool]:
    """Episodes as recordings, and whether velocities were measured (else they are slopes of the positions).

    Velocities that come late, as from filters or slow registers, count as not measured (unless not ``may_lag``). Those
    of another simulation come half a time step late, and so do the model's.

    Takes ``qpos`` and ``qvel``, or a ``state`` that is the two of them one after the other.

    Raises:
        UnusableData: naming the episode, what was expected and what came.
    """
    if not 0 < data.dt <= LONGEST_PAUSE:
        raise UnusableData(f"the control period dt must be above 0 and at most {LONGEST_PAUSE:g} s, got {data.dt:g} s")
    measured = [measured_signals(model, f"episode_{i}", episode) for i, episode in enumerate(data)]
    steps = sum(len(episode.actions) for episode in data)
    if steps < 20:
        raise UnusableData(f"{len(measured)} episodes with {steps} steps are too few to diagnose from")
    sloped = []
    for i, (episode, (qpos, _)) in enumerate(zip(data, measured, strict=True)):
        time = episode.timestamps if episode.timestamps is not None else data.dt * np.arange(len(episode) + 1)
        time, qpos, actions = (np.asarray(x, float) for x in (time, qpos, episode.actions))
        if (gaps := np.diff(time)).max() > LONGEST_PAUSE:
            raise UnusableData(
                f"episode_{i}: a pause of {gaps.max():.4g} s after row {gaps.argmax()}, where nobody knows what was "
                "commanded: make two episodes of it (`idapt import` does)"
            )
        left_out = steps_left_out(f"episode_{i}", episode)
        qvel = slopes(model, time, qpos)
        sloped.append(Recording(f"episode_{i}", time, qpos, qvel, actions, left_out, start_up=start_up(model)))
    if any(qvel is None for _, qvel in measured):
        return with_impacts(model, sloped), False
    shown = [replace(r, qvel=np.asarray(qvel, float)) for r, (_, qvel) in zip(sloped, measured, strict=True)]
    late = lateness(shown, sloped) if may_lag else 0.0
    own = model.opt.timestep / 2  # semi-implicit Euler's velocity is the mean one of the step before
    if late - own > LATEST_VELOCITIES * np.median(np.concatenate([np.diff(r.time) for r in shown])):
        log.warning("measured velocities lag the positions by %.3g s: slopes of the positions are used instead", late)
        return with_impacts(model, sloped), False
    return with_impacts(model, shown), True


def start_up(model: mujoco.MjModel) -> float:
    """How long a model's actuators may go on with what was commanded before an episode, s."""
    filters = np.isin(model.actuator_dyntype, FILTERS)
    slowest = np.max(model.actuator_dynprm[filters, 0] + model.actuator_delay[filters], initial=0.0)
    return max(START_UP, TIME_CONSTANTS * float(slowest))


def steps_left_out(where: str, episode: Episode) -> np.ndarray | None:
    """Control steps that ``infos/left_out`` marks, (T,) bool; None where it marks none.

    Raises:
        UnusableData: it is not one mark for each control step.
    """
    marked = episode.infos.get(LEFT_OUT)
    if marked is None:
        return None
    if marked.shape != (len(episode),) or marked.dtype.kind not in "biu":
        raise UnusableData(
            f"{where}: infos/{LEFT_OUT} is {marked.dtype} {marked.shape}, expected one mark (bool) for each of "
            f"{len(episode)} control steps"
        )
    return marked.astype(bool) if marked.any() else None


def measured_signals(model: mujoco.MjModel, where: str, episode: Episode) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions and velocities (None where they were not measured) of an episode that fits the model.

    Raises:
        UnusableData: one is missing, is not finite, absurdly large, or has another shape than the model asks for.
    """
    seen = episode.observations
    qpos, qvel = seen.get("qpos"), seen.get("qvel")
    if qpos is None and "state" in seen and seen["state"].shape[-1] == model.nq + model.nv:
        qpos, qvel = np.split(seen["state"], [model.nq], axis=-1)
    if qpos is None:
        raise UnusableData(
            f"{where}: no observations/qpos (nor a state of qpos and qvel together); it has: "
            f"{', '.join(sorted(seen)) or 'nothing'}"
        )
    for name, array, width, entries in (
        ("qpos", qpos, model.nq, "qpos entries"),
        ("qvel", qvel, model.nv, "qvel entries"),
        ("actions", episode.actions, model.nu, "actuators"),
    ):
        if array is None:
            continue
        if array.dtype.kind not in "fiub":
            raise UnusableData(f"{where}: {name} holds {array.dtype}, expected numbers")
        if array.ndim != 2 or array.shape[1] != width:
            raise UnusableData(f"{where}: {name} has shape {array.shape}, but the model has {width} {entries}")
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array).all(1))[0])
            raise UnusableData(f"{where}: {name} holds NaN or infinite values, first in row {row}")
        if (far := np.abs(array) >= mujoco.mjMAXVAL).any():
            row, column = np.argwhere(far)[0]
            raise UnusableData(
                f"{where}: {name} holds {array[row, column]:.2g} in column {column}, row {row}, beyond the "
                f"{mujoco.mjMAXVAL:g} at which MuJoCo gives a state up; leave this episode out, or map its columns anew"
            )
    return qpos, qvel


def lateness(shown: list[Recording], sloped: list[Recording]) -> float:
    """By how much measured velocities lag the slopes of the positions [s]; 0 where a lag explains little.

    Least squares on v_measured - v_slope = -lag dv/dt, over all coordinates.
    """
    gap = np.concatenate([a.qvel[1:-1] - b.qvel[1:-1] for a, b in zip(shown, sloped, strict=True)])
    rate = np.concatenate([np.gradient(b.qvel, b.time, axis=0)[1:-1] for b in sloped])
    scale = rate.std(0) + 1e-12
    gap, rate = (gap / scale).ravel(), (rate / scale).ravel()
    lag = -float(gap @ rate) / max(float(rate @ rate), 1e-12)
    explained = 1.0 - np.square(gap + lag * rate).sum() / max(np.square(gap).sum(), 1e-12)
    return lag if explained > 0.25 else 0.0


def slopes(model: mujoco.MjModel, time: np.ndarray, qpos: np.ndarray, reach: int | None = None) -> np.ndarray:
    """Velocities as slopes of the positions over ``reach`` samples (:func:`slope_reach`) to each side, (T+1, nv)."""
    reach = slope_reach(time) if reach is None else reach
    index = np.arange(len(time))
    before, after = np.maximum(index - reach, 0), np.minimum(index + reach, len(time) - 1)
    step = (time[after] - time[before])[:, None]
    if model.nq == model.nv:
        return (qpos[after] - qpos[before]) / step
    out = np.empty((len(time), model.nv))
    for k, (b, a) in enumerate(zip(before, after, strict=True)):
        mujoco.mj_differentiatePos(model, out[k], step[k, 0], qpos[b], qpos[a])
    return out


def slope_reach(time: np.ndarray) -> int:
    """Samples to either side of one that its slope is taken over: about :data:`SLOPE_HALF_WIDTH`, and at least one."""
    return max(1, round(SLOPE_HALF_WIDTH / float(np.median(np.diff(time)))))


def position_difference(model: mujoco.MjModel, qpos: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Other - qpos in the tangent space, (..., nq) to (..., nv)."""
    if model.nq == model.nv:
        return other - qpos
    flat = [a.reshape(-1, model.nq) for a in np.broadcast_arrays(qpos, other)]
    out = np.empty((len(flat[0]), model.nv))
    for row, a, b in zip(out, *flat, strict=True):
        mujoco.mj_differentiatePos(model, row, 1.0, a, b)
    return out.reshape(*np.broadcast_shapes(qpos.shape[:-1], other.shape[:-1]), model.nv)


def shift_positions(model: mujoco.MjModel, qpos: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Qpos moved by ``by`` (n, nv) in the tangent space."""
    if model.nq == model.nv:
        return qpos + by
    moved = np.ascontiguousarray(qpos.copy())
    for row, d in zip(moved, np.broadcast_to(by, (len(qpos), model.nv)), strict=True):
        mujoco.mj_integratePos(model, row, np.ascontiguousarray(d), 1.0)
    return moved


def with_impacts(model: mujoco.MjModel, recordings: list[Recording]) -> list[Recording]:
    """The recordings of free bodies, with where things hit each other: where a velocity jumps between two samples.

    A jump is a change that neither the one before nor the one after has, and that is far beyond the usual. A machine
    with actuators touches things all the time, or moves in jerks anyway.
    """
    if model.nu or not touching_geoms(model):
        return recordings
    jerks = [np.abs(np.diff(r.qvel, n=2, axis=0, prepend=r.qvel[:1])) for r in recordings]
    usual = np.median(np.concatenate(jerks), 0) + 1e-9
    return [replace(r, impacts=(jerk / usual > JUMP).any(1)) for r, jerk in zip(recordings, jerks, strict=True)]


def sample_windows(
    data: list[Recording], episodes: np.ndarray, steps: int, samples: int, limit: int, seed: int
) -> Windows:
    """At most ``limit`` windows of ``steps`` control steps out of some episodes, not overlapping.

    The first steps of an episode are left out where it is long enough: commands from before the
    recording may still act there. So are windows with a step that is left out of the recording. Where things hit each
    other seldom, windows over an impact are a third of all, as far as there are so many: nothing else shows how they
    bounce.
    """
    rng = np.random.default_rng(seed)
    found, hit = [], []
    for e in episodes:
        r, T = data[e], len(data[e])
        most = T // 4 if r.start_up == START_UP else T // 2
        skip = min(int(np.ceil(r.start_up / np.median(np.diff(r.time)))), most, max(0, T - steps))
        starts = window_starts(r.left_out, skip if r.actions.shape[1] else 0, T, steps)
        found.append(np.stack([np.full(len(starts), e), starts], 1))
        hit.append(np.array([has_impact(r, int(s), steps) for s in starts], dtype=np.bool_))
    every = np.concatenate(found) if found else np.zeros((0, 2), int)
    every = every[choose_rows(np.concatenate(hit) if hit else np.zeros(0, bool), limit, rng)]
    offsets = np.unique(np.round(np.linspace(0, steps, samples + 1)[1:]).astype(int))
    return Windows(every[:, 0], every[:, 1], offsets)


def window_starts(left_out: np.ndarray | None, first: int, last: int, steps: int) -> np.ndarray:
    """First steps of windows one after the other from ``first`` to ``last``; anew after what is left out."""
    if left_out is None:
        return np.arange(first, last - steps + 1, steps)
    kept = np.concatenate([[False], ~left_out[first:last], [False]])
    begins, ends = (first + np.flatnonzero(np.diff(kept.astype(int)) == s) for s in (1, -1))
    runs = [np.arange(a, b - steps + 1, steps) for a, b in zip(begins, ends, strict=True)]
    return np.concatenate([*runs, np.zeros(0, int)]).astype(int)


def has_impact(recording: Recording, start: int, steps: int) -> bool:
    """Whether something hits something within so many steps, as far as that is known."""
    return recording.impacts is not None and bool(recording.impacts[start : start + steps].any())


def over_impacts(data: list[Recording], windows: Windows) -> np.ndarray:
    """Which windows are over an impact, (n,)."""
    steps = int(windows.offsets[-1])
    pairs = zip(windows.episode.tolist(), windows.start.tolist(), strict=True)
    return np.array([has_impact(data[e], s, steps) for e, s in pairs], dtype=np.bool_)


def choose_rows(hit: np.ndarray, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Which windows to take: at most ``limit``, and a third of those with an impact where they are rare.

    Args:
        hit: whether each has an impact, (n,).
        limit: at most so many.
        rng: decides among them.
    """
    rows, rare = np.arange(len(hit)), 0 < hit.sum() < SHARE_OF_IMPACTS * len(hit)
    if rare:
        with_impact = rows[hit]
        with_impact = rng.permutation(with_impact)[: max(1, int(SHARE_OF_IMPACTS * limit))]
        wanted = max(int(len(with_impact) * (1 / SHARE_OF_IMPACTS - 1)), FEWEST_WINDOWS - len(with_impact))
        others = rng.permutation(rows[~hit])[: min(wanted, limit - len(with_impact))]
        return np.sort(np.concatenate([with_impact, others]))
    return np.sort(rng.choice(len(hit), limit, replace=False)) if len(hit) > limit else rows

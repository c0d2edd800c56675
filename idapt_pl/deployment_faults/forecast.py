"""How well the nominal model forecasts a recording under a mend: changes of velocity over a few control steps.

The measure is the share of the squared change that the forecast misses, of each degree of freedom: it has no unit, so
that recordings in other units can be compared, and a mend gains nothing by making all motion small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from datamodules import Trajectories
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.deployment_faults.model_mend import mended_model
from idapt_pl.effects.own_signals import first_activations
from idapt_pl.prediction.data import measured_signals, slopes, steps_left_out
from idapt_pl.prediction.rolling import STATE
from idapt_pl.prediction.simulator import silence_mujoco

FORECAST_TIME = 0.06
"""Seconds that a forecast looks ahead, about: longer than a small delay, shorter than what errors of contacts need."""

MOST_FORECAST_STEPS = 4
"""Control steps that it looks ahead at most."""

MOST_PHYSICS_STEPS = 60
"""Physics steps in a control period at most; beyond that it is a wrong period, and not simulated."""

CAP = 3.0
"""Misses count up to so many times the usual change."""

MARGIN = 18
"""Control steps at either end of an episode in which no forecast begins or ends, as a shift may use them up."""


@dataclass(frozen=True)
class Signals:
    """One episode as arrays: time (T+1,), qpos (T+1, nq), qvel (T+1, nv), actions (T, nu)."""

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    actions: np.ndarray


@dataclass(frozen=True)
class Starts:
    """Where forecasts begin: episode and row, as in the recording, and the block that each belongs to, (n,) each."""

    episode: np.ndarray
    row: np.ndarray
    block: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> Starts:
        return Starts(self.episode[chosen], self.row[chosen], self.block[chosen])

    def __len__(self) -> int:
        return len(self.row)


def signals_of(model: mujoco.MjModel, data: Trajectories) -> list[Signals]:
    """Episodes as arrays; velocities that were not measured are slopes of the positions.

    Raises:
        UnusableData: the recording does not fit the model.
    """
    made = []
    for i, e in enumerate(data):
        qpos, qvel = measured_signals(model, f"episode_{i}", e)
        time = data.dt * np.arange(len(e) + 1) if e.timestamps is None else e.timestamps
        qpos = np.asarray(qpos, float)
        velocities = slopes(model, time, qpos, 1) if qvel is None else np.asarray(qvel, float)
        made.append(Signals(np.asarray(time, float), qpos, velocities, np.asarray(e.actions, float)))
    return made


def choose_starts(
    lengths: list[int], steps: int, limit: int, seed: int, left_out: Sequence[np.ndarray | None] = ()
) -> Starts:
    """Rows to forecast from, at most ``limit``, in blocks of about equal length: at least six altogether.

    Args:
        lengths: control steps of each episode.
        steps: control steps of a forecast.
        limit: of their number.
        seed: of the choice.
        left_out: of each episode, control steps that no forecast may touch, (T,) bool; none where there is none.
    """
    rng = np.random.default_rng(seed)
    parts = max(1, -(-6 // max(len(lengths), 1)))
    rows, blocks, episodes = [], [], []
    for e, T in enumerate(lengths):
        margin = min(MARGIN, T // 4)
        at = np.arange(margin, T - steps - margin)
        if (marked := left_out[e] if left_out else None) is not None:
            total = np.concatenate([[0], np.cumsum(marked)])
            at = at[total[at + steps] == total[at]]
        rows.append(at)
        episodes.append(np.full(len(at), e))
        blocks.append(e * parts + (np.arange(len(at)) * parts) // max(len(at), 1))
    every = Starts(*(np.concatenate([*x, np.zeros(0, int)]).astype(int) for x in (episodes, rows, blocks)))
    if len(every) <= limit:
        return every
    return every[np.sort(rng.choice(len(every), limit, replace=False))]


class RecordingForecasts:
    """Forecasts of a recording by a model, under mends.

    Args:
        model: the nominal model, compiled.
        data: the recording.
        period: factor on its control period, where that is known to be wrong.
        limit: of the number of forecasts.
        seed: of where they begin.
    """

    def __init__(
        self, model: mujoco.MjModel, data: Trajectories, period: float = 1.0, limit: int = 500, seed: int = 0
    ) -> None:
        self.model, self.data = model, data
        self.joints = ScalarJoints.of(model)
        self.simulated = mujoco.MjData(model)
        self.steps = int(np.clip(round(FORECAST_TIME / max(data.dt * period, 1e-6)), 1, MOST_FORECAST_STEPS))
        marks = [steps_left_out(f"episode_{i}", e) for i, e in enumerate(data)]
        self.starts = choose_starts([len(e) for e in data], self.steps, limit, seed, marks)

    def signals(self, mend: Mend) -> list[Signals]:
        """The mended recording as arrays."""
        return signals_of(self.model, mend.apply(self.model, self.data))

    def misses(self, mend: Mend, starts: Starts) -> np.ndarray:
        """Squared misses relative to the usual squared change, (n, nv), at most ``CAP`` squared each."""
        signals, first = self.signals(mend), mend.margins[0]
        at = starts.row - first
        before, after = (gather(signals, "qvel", starts.episode, at + k) for k in (0, self.steps))
        controls = np.stack([gather(signals, "actions", starts.episode, at + k) for k in range(self.steps)], 1)
        period = float(np.median(np.concatenate([np.diff(s.time) for s in signals])))
        qpos = gather(signals, "qpos", starts.episode, at)
        usual = np.sqrt(np.square(after - before).mean(0)) + 1e-12
        predicted = forecast(mended_model(self.model, mend), self.simulated, qpos, before, controls, period)
        miss = np.nan_to_num((after - predicted) / usual, nan=CAP, posinf=CAP, neginf=-CAP)
        return np.square(miss.clip(-CAP, CAP))


def gather(signals: list[Signals], name: str, episode: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Rows of a channel, (n, size)."""
    channel = [getattr(s, name) for s in signals]
    return np.stack([channel[e][k] for e, k in zip(episode, row, strict=True)])


def forecast(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray, qvel: np.ndarray, controls: np.ndarray, period: float
) -> np.ndarray:
    """Velocities after some control steps, (n, nv); NaN where the control period is out of all proportion.

    Args:
        model: to simulate.
        data: room for it.
        qpos: where it begins, (n, nq).
        qvel: and how fast, (n, nv).
        controls: held for a control period each, (n, steps, nu).
        period: of control, s.
    """
    n, steps, _ = controls.shape
    each = round(period / model.opt.timestep)
    if not 1 <= max(each, 1) <= MOST_PHYSICS_STEPS * max(1.0, 0.002 / model.opt.timestep):
        return np.full(qvel.shape, np.nan)
    each = max(each, 1)
    start = np.zeros((n, mujoco.mj_stateSize(model, STATE)))
    start[:, 1 : 1 + model.nq] = qpos
    start[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
    if model.na:
        start[:, 1 + model.nq + model.nv :][:, : model.na] = first_activations(model, qpos, controls[:, 0])
    with other_timestep(model, period / each), silence_mujoco():
        states, _ = rollout.rollout(model, data, start, np.repeat(controls, each, 1), nstep=steps * each)
    return states[:, -1, 1 + model.nq : 1 + model.nq + model.nv]


@contextmanager
def other_timestep(model: mujoco.MjModel, value: float) -> Iterator[None]:
    """Another time step for a while."""
    before, model.opt.timestep = model.opt.timestep, value
    try:
        yield
    finally:
        model.opt.timestep = before


@dataclass(frozen=True)
class Gain:
    """By how much a mend improves forecasts.

    Attributes:
        log_ratio: of squared misses without and with it, summed over degrees of freedom.
        error: its standard error.
    """

    log_ratio: float
    error: float

    def certain(self, least: float, sigmas: float) -> bool:
        """Whether it is at least so large, and so many standard errors from nothing."""
        return self.log_ratio >= least and self.log_ratio >= sigmas * self.error


def gain_between(before: np.ndarray, after: np.ndarray, blocks: np.ndarray) -> Gain:
    """How much smaller squared misses are after than before; the error by leaving out one block at a time.

    Args:
        before: squared misses without the mend, (n, nv).
        after: with it, from the same starts.
        blocks: which belong together, (n,).
    """
    names = np.unique(blocks)
    sums = np.stack([[m[blocks == b].sum(0) for b in names] for m in (before, after)])

    def ratio(total: np.ndarray) -> float:
        return float(np.log((total[0] + 1e-9) / (total[1] + 1e-9)).sum())

    total = sums.sum(1)
    if len(names) < 3:
        return Gain(ratio(total), np.inf)
    left_out = np.array([ratio(total - sums[:, b]) for b in range(len(names))])
    return Gain(ratio(total), float(np.sqrt((len(names) - 1) * np.var(left_out))))

"""Which recorded command drives which actuator, how strongly, and when: inverse dynamics through the simulator.

What the recorded changes of velocity need beyond the model without commands is regressed on what each actuator does to
the model with each recorded command, at each shift in time. The matrix found is the unit matrix where all is right.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from idapt_pl.deployment_faults.forecast import RecordingForecasts, Signals, Starts, forecast, gather
from idapt_pl.deployment_faults.mend import Mend
from idapt_pl.deployment_faults.model_mend import mended_model
from idapt_pl.estimation.robust import robust_deviation

FURTHEST = 16
"""Shifts that are tried, in control steps to either side."""


@dataclass(frozen=True)
class Influence:
    """What commands do, by the recording.

    Attributes:
        late: shifts in control steps: a command that is 2 late acts two steps after it was noted, (shifts,).
        unexplained: share of the change that is left at each shift, (shifts,).
        matrix: of the best shift: actuator i gets ``matrix[i, j]`` times the recorded command j, (nu, nu).
        matrix_error: standard errors, (nu, nu).
        weight: how much of the motion each recorded command makes through each actuator, (nu, nu).
        own_late: best shift of each actuator with its strongest command, the others at the common one, (nu,).
    """

    late: np.ndarray
    unexplained: np.ndarray
    matrix: np.ndarray
    matrix_error: np.ndarray
    weight: np.ndarray
    own_late: np.ndarray

    @property
    def best(self) -> int:
        """The shift that leaves least."""
        return int(self.late[np.argmin(self.unexplained)])


def measure_influence(forecaster: RecordingForecasts, mend: Mend, starts: Starts) -> Influence:
    """Regress what the motion needs on the recorded commands, at each shift in time.

    Args:
        forecaster: of the recording.
        mend: the changes that are certain so far.
        starts: rows to look at.
    """
    signals, first = forecaster.signals(mend), mend.margins[0]
    at = starts.row - first
    need, response = one_step(mended_model(forecaster.model, mend), signals, starts.episode, at)
    nuisance = Nuisance.at(*(gather(signals, n, starts.episode, at) for n in ("qpos", "qvel")))
    need, response = in_usual_units(nuisance.without(need), response)
    # rows of all shifts must exist in every episode: beyond its ends the first and last command stand
    last = np.array([len(s.actions) - 1 for s in signals])[starts.episode]
    furthest = min(FURTHEST, min(len(s.actions) for s in signals) // 4)
    late = np.arange(-furthest, furthest + 1)
    shift = {
        int(s): gather(signals, "actions", starts.episode, np.clip(at - s, 0, last)) for s in late
    }  # fmt: skip
    driven = {s: nuisance.without(response[:, :, :, None] * u[:, None, None, :]) for s, u in shift.items()}
    left = np.stack([leftover(need, x, starts.block)[0] for x in driven.values()])
    best = int(np.argmin(left.sum(1)))
    _, matrix, error, weight = leftover(need, driven[int(late[best])], starts.block)
    total = max(float(np.square(need).sum()), 1e-12)
    own = own_shifts(need, driven, matrix, weight, int(late[best]))
    return Influence(late, left.sum(1) / total, matrix, error, weight, own)


def one_step(
    model: mujoco.MjModel, signals: list[Signals], episode: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a control step needs beyond the model without commands, and what a unit of each command does.

    Limits of commands and forces are off, so that what commands do is linear in them.

    Returns:
        The need, (n, nv), and the response, (n, nv, nu).
    """
    free = copy(model)
    free.actuator_ctrllimited[:] = 0
    free.actuator_forcelimited[:] = 0
    room = mujoco.MjData(free)
    qpos, qvel, after = (gather(signals, n, episode, at + k) for n, k in (("qpos", 0), ("qvel", 0), ("qvel", 1)))
    period = float(np.median(np.concatenate([np.diff(s.time) for s in signals])))
    off = np.zeros((len(at), 1, model.nu))
    still = forecast(free, room, qpos, qvel, off, period)
    response = np.empty((len(at), model.nv, model.nu))
    for i in range(model.nu):
        on = off.copy()
        on[..., i] = size = 0.1 * command_size(model, i)
        response[..., i] = (forecast(free, room, qpos, qvel, on, period) - still) / size
    return np.nan_to_num(after - still), np.nan_to_num(response)


def command_size(model: mujoco.MjModel, i: int) -> float:
    """Half the range of an actuator's command; 1 where it has none."""
    low, high = model.actuator_ctrlrange[i]
    return float(high - low) / 2 if model.actuator_ctrllimited[i] and high > low else 1.0


@dataclass(frozen=True)
class Nuisance:
    """What may explain the need beside commands, of each degree of freedom: bases of (n, few), orthonormal.

    A constant, the position, the velocity and its sign: so friction, springs and offsets that the model lacks take
    nothing from what commands explain.
    """

    bases: tuple[np.ndarray, ...]

    @classmethod
    def at(cls, qpos: np.ndarray, qvel: np.ndarray) -> Nuisance:
        """For measured positions (n, nq) and velocities (n, nv)."""
        bases = []
        for d, v in enumerate(qvel.T):
            columns = [np.ones(len(v)), v, np.tanh(v / (0.2 * v.std() + 1e-9))]
            if qpos.shape[1] == qvel.shape[1]:
                columns.append(qpos[:, d])
            bases.append(np.linalg.qr(np.stack(columns, 1))[0])
        return cls(tuple(bases))

    def without(self, x: np.ndarray) -> np.ndarray:
        """An array (n, nv, ...) without what this explains of it."""
        out = x.copy()
        for d, Q in enumerate(self.bases):
            flat = out[:, d].reshape(len(out), -1)
            out[:, d] = (flat - Q @ (Q.T @ flat)).reshape(out[:, d].shape)
        return out


def in_usual_units(need: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Need and response in units of the usual need of each degree of freedom; outliers, as of contacts, are cut."""
    scale = robust_deviation(need)
    scale = np.maximum(scale, 0.3 * need.std(0)) + 1e-9
    return (need / scale).clip(-6, 6), response / scale[:, None]


def leftover(
    need: np.ndarray, driven: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Squares that are left in each block (blocks,), the matrix, its standard errors and its weights, (nu, nu) each."""
    n, nv, nu, _ = driven.shape
    columns = driven.reshape(n * nv, nu * nu)
    square = columns.T @ columns
    ridge = 1e-6 * max(float(np.trace(square)) / max(len(square), 1), 1e-12)
    inverse = np.linalg.inv(square + ridge * np.eye(len(square)))
    x = inverse @ (columns.T @ need.ravel())
    left = need - (columns @ x).reshape(n, nv)
    scores = (columns * left.ravel()[:, None]).reshape(n, nv, -1).sum(1)
    names = np.unique(blocks)
    grouped = np.stack([scores[blocks == b].sum(0) for b in names])
    V = inverse @ (grouped.T @ grouped) @ inverse * len(names) / max(len(names) - 1, 1)
    rms = np.sqrt(np.square(columns).mean(0))
    squares = np.array([np.square(left[blocks == b]).sum() for b in names])
    return squares, x.reshape(nu, nu), np.sqrt(np.diag(V)).reshape(nu, nu), (np.abs(x) * rms).reshape(nu, nu)


def own_shifts(
    need: np.ndarray, driven: dict[int, np.ndarray], matrix: np.ndarray, weight: np.ndarray, common: int
) -> np.ndarray:
    """Of each actuator, the shift of its strongest command that leaves least, (nu,); all begin at the common one."""
    nu = len(matrix)
    source = [int(np.argmax(w)) for w in weight]
    own = np.full(nu, common)
    for _ in range(2):
        for i in range(nu):
            others = need.copy()
            for k in range(nu):
                if k != i:
                    others -= driven[int(own[k])][:, :, k, source[k]] * matrix[k, source[k]]
            fits = {}
            for s, x in driven.items():
                column = x[:, :, i, source[i]]
                fits[s] = float((column * others).sum()) ** 2 / max(float(np.square(column).sum()), 1e-12)
            best = max(fits, key=lambda s: fits[s])
            own[i] = best
    return own

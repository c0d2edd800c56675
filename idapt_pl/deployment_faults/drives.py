"""Servos read as motors, and motors read as servos: what commands and positions do to the motion tells the two apart.

What the recorded changes of velocity need beyond the model without any drives is regressed on command, position and
velocity of each driven joint. Of a servo, the position counts as much as the command, with the other sign; of a motor,
nothing. Forecasts with the model's drives changed then decide, as for all other faults.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from idapt_pl.deployment_faults.forecast import RecordingForecasts, Starts, forecast, gather
from idapt_pl.deployment_faults.hypotheses import Hypothesis
from idapt_pl.deployment_faults.joints import ScalarJoints
from idapt_pl.deployment_faults.mend import Drive, Mend
from idapt_pl.deployment_faults.model_mend import with_drives
from idapt_pl.estimation.robust import robust_deviation

SURE_OF_DRIVE = 6.0
"""Standard errors from nothing at which a joint's position (or command) is taken to count."""

LIKE_COMMAND = 1.5
"""Of a servo, position and command count alike up to this factor."""

UNLIKE_SERVO = 0.2
"""Of a motor, the position counts less than this share of what it would under the model's servo."""

LIKE_TORQUE = 2.0
"""Commands are torques if they count as such up to this factor."""


@dataclass(frozen=True)
class DriveLaw:
    """What drives a joint, by the recording: torque = command c + position q + velocity v, each times a coefficient.

    Attributes:
        coefficients: of command, position and velocity, (3,).
        errors: their standard errors, (3,).
    """

    coefficients: np.ndarray
    errors: np.ndarray

    def certain(self, k: int) -> bool:
        """Whether a coefficient is surely there."""
        return bool(abs(self.coefficients[k]) > SURE_OF_DRIVE * self.errors[k])


def driven_joints(model: mujoco.MjModel, joints: ScalarJoints) -> dict[int, int]:
    """Actuators that are alone on a hinge or slide, with the joint's number among them."""
    return {a[0]: j for j, a in enumerate(joints.actuators) if len(a) == 1 and model.actuator_gear[a[0], 0]}


def drive_hypotheses(forecaster: RecordingForecasts, mend: Mend, starts: Starts) -> Iterator[Hypothesis]:
    """Motors that are servos, or servos that are motors; all at once that look like it."""
    model = forecaster.model
    driven = driven_joints(model, forecaster.joints)
    if mend.drives or not driven or model.na:
        return
    laws = drive_laws(forecaster, mend, starts, driven)
    servos: list[Drive | None] = [None] * model.nu
    motors: list[Drive | None] = [None] * model.nu
    for i, law in laws.items():
        c, q, v = law.coefficients
        kp = -float(model.actuator_biasprm[i, 1]) * float(model.actuator_gear[i, 0]) ** 2
        if kp == 0 and law.certain(0) and law.certain(1) and q < 0 < c and abs(np.log(-c / q)) < np.log(LIKE_COMMAND):
            stiffness = float(np.sqrt(-c * q))
            servos[i] = (stiffness, -stiffness, -max(-float(v), 0.0))
        if kp > 0 and law.certain(0) and abs(np.log(max(c, 1e-9))) < np.log(LIKE_TORQUE) and -q < UNLIKE_SERVO * kp:
            motors[i] = (1.0, 0.0, 0.0)
    if any(servos):
        yield Hypothesis("servos read as motors", replace(mend, drives=tuple(servos)))
    if any(motors):
        yield Hypothesis("motors read as servos", replace(mend, drives=tuple(motors)))


def drive_laws(
    forecaster: RecordingForecasts, mend: Mend, starts: Starts, driven: dict[int, int]
) -> dict[int, DriveLaw]:
    """Regress what a control step needs beyond the model without drives on what could drive each joint.

    Args:
        forecaster: of the recording.
        mend: what is certain so far.
        starts: rows to look at.
        driven: actuators, with the joints that they drive.
    """
    signals, joints, model = forecaster.signals(mend), forecaster.joints, forecaster.model
    at = starts.row - mend.margins[0]
    qpos, qvel, u = (gather(signals, n, starts.episode, at) for n in ("qpos", "qvel", "actions"))
    after = gather(signals, "qvel", starts.episode, at + 1)
    period = float(np.median(np.concatenate([np.diff(s.time) for s in signals])))
    bare = with_drives(model, tuple((1.0, 0.0, 0.0) if i in driven else None for i in range(model.nu)))
    room, off = mujoco.MjData(bare), np.zeros((len(at), 1, model.nu))
    still = forecast(bare, room, qpos, qvel, off, period)
    need, columns = np.nan_to_num(after - still), []
    usual = robust_deviation(need) + 1e-9
    for i, j in driven.items():
        on = off.copy()
        on[..., i] = size = 1e-2 * (np.abs(u[:, i]).mean() + 1e-6)
        response = np.nan_to_num(forecast(bare, room, qpos, qvel, on, period) - still) / size / usual
        q, v = qpos[:, joints.q[j]], qvel[:, joints.v[j]]
        columns += [response * x[:, None] for x in (u[:, i], q, v, np.ones(len(at)))]
    X = np.stack([c.ravel() for c in columns], 1)
    y = (need / usual).clip(-20, 20).ravel()
    x, error = least_squares_by_block(X, y, np.repeat(starts.block, need.shape[1]))
    return {i: DriveLaw(x[4 * k : 4 * k + 3], error[4 * k : 4 * k + 3]) for k, i in enumerate(driven)}


def least_squares_by_block(X: np.ndarray, y: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (p,) of columns (rows, p), and their standard errors, robust to noise that is alike in a block."""
    scale = np.sqrt(np.square(X).mean(0)) + 1e-12
    A = X / scale
    inverse = np.linalg.pinv(A.T @ A + 1e-9 * len(A) * np.eye(A.shape[1]))
    x = inverse @ (A.T @ y)
    scores = A * (y - A @ x)[:, None]
    names = np.unique(blocks)
    grouped = np.stack([scores[blocks == b].sum(0) for b in names])
    V = inverse @ (grouped.T @ grouped) @ inverse * len(names) / max(len(names) - 1, 1)
    return x / scale, np.sqrt(np.maximum(np.diag(V), 0)) / scale


def without_servo(mend: Mend) -> Mend:
    """The same drives as motors with the servo's damping: what a gain and friction that a model lacks would do."""
    return replace(mend, drives=tuple(d if d is None else (d[0], 0.0, d[2]) for d in mend.drives))

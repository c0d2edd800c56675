"""Forecasts and what was read, channel by channel, in the words of report.json."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.image_diagnosis.calibration import Calibration
from idapt_pl.image_diagnosis.forecasts import ComparedChannels, ObservedStart


def rounded(x: float) -> float:
    """Six digits are enough."""
    return float(f"{x:.6g}")


def channel_names(compared: ComparedChannels) -> list[tuple[str, str]]:
    """Names and units of what is compared: positions first, then velocities."""
    joints = [compared.model.joint(compared.model.dof_jntid[i]) for i in compared.dofs]
    turns = [int(j.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE) for j in joints]
    names = [j.name for j in joints] + [f"{j.name} velocity" for j in joints]
    units = ["rad" if t else "m" for t in turns] + ["rad/s" if t else "m/s" for t in turns]
    return list(zip(names, units, strict=True))


def channel_errors(
    compared: ComparedChannels, calibration: Calibration, before: np.ndarray, after: np.ndarray
) -> dict[str, dict]:
    """Errors (d,) of the means of forecasts, without and with effects, beside the sensor's."""
    noise = np.concatenate([calibration.position[compared.dofs], calibration.velocity[compared.dofs]])
    return {
        name: {"before": rounded(b), "after": rounded(a), "noise": rounded(n), "unit": unit}
        for (name, unit), b, a, n in zip(channel_names(compared), before, after, noise, strict=True)
    }


def example_episode(
    compared: ComparedChannels, sightings: Sequence[ObservedStart], before: Sequence[np.ndarray], after: Sequence[np.ndarray],
    gains: np.ndarray, dt: float,
) -> dict:  # fmt: skip
    """The episode that gains as much as most do: its positions as read, and ensembles without and with effects.

    Args:
        compared: what is.
        sightings: of the target.
        before: ensembles of each, (members, T+1, d), without effects.
        after: with them; the same where there are none.
        gains: of each, (n,), of any scale.
        dt: control period, s.
    """
    k = int(np.argsort(gains, kind="stable")[len(gains) // 2])

    def band(members: np.ndarray) -> dict[str, list[float]]:
        rows = {"mean": members.mean(0), "low": members.min(0), "high": members.max(0)}
        return {name: [rounded(x) for x in values] for name, values in rows.items()}

    return {
        "dt": dt,
        "channels": {
            name: {
                "unit": unit,
                "read": [rounded(x) for x in sightings[k].read[:, i]],
                "before": band(before[k][..., i]),
                "after": band(after[k][..., i]),
            }
            for i, (name, unit) in enumerate(channel_names(compared)[: len(compared.dofs)])
        },
    }

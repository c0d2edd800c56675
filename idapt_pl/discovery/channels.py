"""Forecasts and what was read, channel by channel, in the words of report.json."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from idapt_pl.discovery.forecasts import Compared, Sighting
from idapt_pl.sensing import Calibration


def rounded(x: float) -> float:
    """Six digits are enough."""
    return float(f"{x:.6g}")


def channels(compared: Compared) -> list[tuple[str, str]]:
    """Names and units of what is compared: positions first, then velocities."""
    joints = [compared.model.joint(compared.model.dof_jntid[i]) for i in compared.dofs]
    turns = [int(j.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE) for j in joints]
    names = [j.name for j in joints] + [f"{j.name} velocity" for j in joints]
    units = ["rad" if t else "m" for t in turns] + ["rad/s" if t else "m/s" for t in turns]
    return list(zip(names, units, strict=True))


def errors(compared: Compared, calibration: Calibration, before: np.ndarray, after: np.ndarray) -> dict[str, dict]:
    """Errors (d,) of the means of forecasts, without and with effects, beside the sensor's."""
    noise = np.concatenate([calibration.position[compared.dofs], calibration.velocity[compared.dofs]])
    return {
        name: {"before": rounded(b), "after": rounded(a), "noise": rounded(n), "unit": unit}
        for (name, unit), b, a, n in zip(channels(compared), before, after, noise, strict=True)
    }


def example(
    compared: Compared, sightings: Sequence[Sighting], before: Sequence[np.ndarray], after: Sequence[np.ndarray],
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
            for i, (name, unit) in enumerate(channels(compared)[: len(compared.dofs)])
        },
    }

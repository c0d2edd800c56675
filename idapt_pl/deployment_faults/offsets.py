"""The size of a joint's wrong zero, and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from idapt_pl.deployment_faults.forecast import RecordingForecasts, Starts
from idapt_pl.deployment_faults.hypotheses import Hypothesis
from idapt_pl.deployment_faults.mend import Mend

SMALLEST_OFFSET = 0.2
"""Offsets below this [rad] are left to the diagnosis, which tells them from tilts, springs and biases."""

REACH = 0.25
"""How far from where it was tried an offset is looked for, rad."""

GROUPS = 4
"""Parts of the recording that offsets are estimated from for an interval."""


def refine_offset(forecaster: RecordingForecasts, hypothesis: Hypothesis, starts: Starts) -> Hypothesis:
    """A hypothesis about a joint's zero where it fits best; others as they are."""
    if hypothesis.offset_of is None:
        return hypothesis
    by = best_offset(forecaster, hypothesis.mend, hypothesis.offset_of, starts)
    return replace(hypothesis, mend=hypothesis.mend.moved_joint(forecaster.joints, hypothesis.offset_of, by))


def best_offset(forecaster: RecordingForecasts, mend: Mend, joint: int, starts: Starts) -> float:
    """What to add to a joint's offset, rad."""

    def loss(by: float) -> float:
        misses = forecaster.misses(mend.moved_joint(forecaster.joints, joint, by), starts)
        return float(np.log(misses.mean(0) + 1e-9).sum())

    found = minimize_scalar(loss, bounds=(-REACH, REACH), method="bounded", options={"xatol": 2e-3, "maxiter": 14})
    return float(found.x)


def small_offset(mend: Mend, now: Mend) -> bool:
    """Whether a mend is another by an offset that physics may explain as well."""
    return any(0 < abs(a - b) < SMALLEST_OFFSET for a, b in zip(mend.q_offset, now.q_offset, strict=True))


def offset_interval(forecaster: RecordingForecasts, mend: Mend, name: str) -> tuple[float, float]:
    """95 % interval of a joint's offset [rad], from estimates in parts of the recording."""
    j, starts = forecaster.joints.names.index(name), forecaster.starts
    parts: Sequence[np.ndarray] = [np.flatnonzero(starts.block % GROUPS == g) for g in range(GROUPS)]
    found = [best_offset(forecaster, mend, j, starts[p]) for p in parts if len(p) > 8]
    now = mend.q_offset[forecaster.joints.q[j]]
    if len(found) < 2:
        return round(now - REACH, 4), round(now + REACH, 4)
    half = float(student.ppf(0.975, len(found) - 1) * np.std(found, ddof=1) / np.sqrt(len(found)))
    middle = now + float(np.mean(found))
    return round(min(now, middle - half), 4), round(max(now, middle + half), 4)

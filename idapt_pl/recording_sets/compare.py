"""What was found, fitted to each file alone: which values differ?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import norm

from idapt_pl.diagnosis.answer.result import ParameterEstimate
from idapt_pl.diagnosis.answer.summary import parameter_estimates
from idapt_pl.diagnosis.candidates.fit import effects_of, split_parameters
from idapt_pl.diagnosis.rounds.measurement import with_interval
from idapt_pl.diagnosis.search import Diagnosis
from idapt_pl.estimation.intervals import clusters_of, half_widths
from idapt_pl.prediction.data import Windows, sample_windows
from idapt_pl.prediction.force_windows import judged_by_forces
from idapt_pl.prediction.whitening import WhitenedWindows, initial_sensitivity, whitener
from idapt_pl.recording_sets.join import RecordingSet
from idapt_pl.recording_sets.result import ChangedValue, SetComparison, SetResult, SetValue

MOST_WINDOWS = 250
"""Windows of each file."""

CHANCE = 0.005
"""Chance that any value is said to differ although none does, if intervals are as wide as they should be."""

WORTH_SAYING = 0.05
"""A difference also has to be so large, in units of what is noticeable."""

MUCH_MORE = 1.3
"""Error left in a file, in that of the typical one, from which something else differs there."""


@dataclass(frozen=True, eq=False)
class OwnFit:
    """The common answer's effects, fitted to one file.

    Attributes:
        x: their parameters one after the other, (p,).
        half: half widths of their 95 % intervals, (p,).
        result: the same for the report.
    """

    x: np.ndarray
    half: np.ndarray
    result: SetResult


def compare_sets(diagnosis: Diagnosis, sets: Sequence[RecordingSet]) -> SetComparison:
    """Fit what a diagnosis of all files found to each of them alone, and compare.

    Args:
        diagnosis: of all recordings together.
        sets: the files.
    """
    fits = [fit_to_set(diagnosis, s) for s in sets]
    results = tuple(f.result for f in fits)
    left = [r.own for r in results if r.comparable]
    unlike = [r.recordings.name for r in results if r.own > MUCH_MORE * max(float(np.median(left)), 1.0)]
    return SetComparison(
        results,
        tuple(changed_values(diagnosis, [f for f in fits if f.result.comparable])),
        tuple(unlike),
        tuple(diagnosis.result.effects),
        diagnosis.result.error.yardstick,
    )


def fit_to_set(diagnosis: Diagnosis, recordings: RecordingSet) -> OwnFit:
    """The common answer's effects, fitted to one file; nothing where it has no window."""
    context, state = diagnosis.context, diagnosis.state
    sim = context.sim
    windows = sample_windows(sim.data, np.array(recordings.episodes), context.steps, 5, MOST_WINDOWS, context.seed)
    if not len(windows):
        return OwnFit(np.zeros(0), np.zeros(0), SetResult(recordings, np.nan, np.nan, np.nan, {}))
    split = judged_alike(diagnosis, windows)

    def error(effects: tuple) -> float:
        return round(float(np.sqrt(context.loss(split, effects).mean())), 4)

    before, common = error(context.declared), error(state.effects)
    if not state.accepted:
        return OwnFit(np.zeros(0), np.zeros(0), SetResult(recordings, before, common, common, {}))
    fit = context.fit(split, state.fixed, state.candidates, state.estimates, 8, exact=True)
    own = error((*state.fixed, *effects_of(state.candidates, fit.x)))
    clusters = clusters_of(split.windows.episode, split.windows.start)
    half = half_widths(fit.solution, clusters) * np.concatenate([c.scale for c in state.candidates])
    halves = split_parameters(state.candidates, half)
    timestep, values = sim.compile(state.fixed).opt.timestep, dict[SetValue, ParameterEstimate]()
    for a, h in zip(state.with_estimates(fit.x).accepted, halves, strict=True):
        own_values = parameter_estimates(sim.model, with_interval(a, h, timestep))
        values |= {(a.candidate.kind.name, a.candidate.target, name): p for name, p in own_values.items()}
    return OwnFit(np.concatenate(fit.x), half, SetResult(recordings, before, common, own, values))


def judged_alike(diagnosis: Diagnosis, windows: Windows) -> WhitenedWindows:
    """Windows of a file, judged as the search judged its own: by forces, or by forecasts and the noise of sensors."""
    sim, effects, noise = diagnosis.sim, diagnosis.effects, diagnosis.state.windows.noise
    if noise.forces is not None:
        return judged_by_forces(windows, noise.forces)
    at = initial_sensitivity(sim, effects, windows, noise.start)
    return WhitenedWindows(windows, whitener(at, noise, sim.compared, windows.offsets))


def changed_values(diagnosis: Diagnosis, fits: Sequence[OwnFit]) -> list[ChangedValue]:
    """Values that differ between files surely and noticeably, the surest first.

    The pair of files that differ most decides, at a level that allows for all pairs and all values.
    """
    candidates = diagnosis.state.candidates
    values = [(c.kind.name, c.target, name) for c in candidates for name in c.names]
    scale = np.concatenate([c.scale for c in candidates]) if candidates else np.zeros(0)
    pairs = list(combinations(range(len(fits)), 2))
    sure = float(norm.isf(CHANCE / 2 / max(len(pairs) * len(values), 1)))
    found = []
    for k, value in enumerate(values):
        x, error = (np.array([getattr(f, n)[k] for f in fits]) for n in ("x", "half"))
        error = error / norm.isf(0.025)
        sigmas = [abs(x[i] - x[j]) / max(float(np.hypot(error[i], error[j])), 1e-12) for i, j in pairs]
        if not sigmas or max(sigmas) < sure or np.ptp(x) < WORTH_SAYING * scale[k]:
            continue
        names = [f.result.recordings.name for f in fits]
        found.append(ChangedValue(value, names[int(np.argmin(x))], names[int(np.argmax(x))], float(max(sigmas))))
    return sorted(found, key=lambda c: -c.sigmas)

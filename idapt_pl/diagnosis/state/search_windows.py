"""The windows that a search fits and judges on, and what whitens them under the current model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idapt_pl.diagnosis.state.context import SAME_WHEN_COARSE, SearchContext
from idapt_pl.prediction.data import Windows, sample_windows
from idapt_pl.prediction.force_windows import judged_by_forces
from idapt_pl.prediction.noise import Noise, estimate_noise
from idapt_pl.prediction.simulator import Effects
from idapt_pl.prediction.whitening import (
    InitialStateSensitivity,
    WhitenedWindows,
    initial_sensitivity,
    moved_little,
    whitener,
)

SAME_SENSITIVITIES = 0.25
"""Share of what is left (squared) by which predictions may move before sensitivities are measured again."""

SECONDS_PER_STEP = 1e-5
"""Nominal cost of simulating one step of one window, about what small machines with contacts take on two cores."""


@dataclass(frozen=True)
class ModelStructure:
    """A model but for the values of what was found: sensitivities to first states are kept while it is the same.

    Attributes:
        fixed: declared effects, and numerics if any were found.
        found: labels of the effects found.
    """

    fixed: Effects
    found: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class WindowSensitivity:
    """Windows of a search, and how they depend on their first states under a model of some structure.

    Attributes:
        structure: of the model.
        residual: that it leaves of ``fit``, (n, j, channels).
        fit: windows of the fitted episodes.
        held_out: windows of the others.
        at_fit: sensitivity of the former.
        at_held_out: of the latter.
    """

    structure: ModelStructure
    residual: np.ndarray
    fit: Windows
    held_out: Windows
    at_fit: InitialStateSensitivity
    at_held_out: InitialStateSensitivity


@dataclass(frozen=True, eq=False)
class SearchWindows:
    """Whitened windows.

    Attributes:
        noise: of the sensors, as given, or estimated under the current model.
        sensitivity: with which they are whitened.
        fit: of the fitted episodes.
        screen: some of these.
        scout: fewer of them.
        held_out: of the episodes that nothing is fitted to.
    """

    noise: Noise
    sensitivity: WindowSensitivity
    fit: WhitenedWindows
    screen: WhitenedWindows
    scout: WhitenedWindows
    held_out: WhitenedWindows


def whiten_windows(
    context: SearchContext,
    structure: ModelStructure,
    effects: Effects,
    noise: Noise,
    known: WindowSensitivity | None = None,
) -> SearchWindows:
    """Windows of a search, whitened under a model.

    Args:
        context: of the search.
        structure: of the model.
        effects: all of the model's.
        noise: as it was taken to be so far. It is estimated again, unless it is given, or forces are judged.
        known: sensitivities so far. They are dear, so they are kept while the model is much the same.
    """
    sim, s, possible = context.sim, context.settings, affordable_windows(context, structure.fixed)
    fit: WhitenedWindows
    held_out: WhitenedWindows
    if known is not None and noise.forces is not None:
        fit, held_out = (judged_by_forces(w, noise.forces) for w in (known.fit, known.held_out))
    else:
        if known is None or not still_hold(context, known, structure, effects, noise):
            known = measure_sensitivity(context, structure, effects, noise)
        noise = context.known_noise or estimate_noise(sim, effects, context.probe)
        fit = WhitenedWindows(known.fit, whitener(known.at_fit, noise, sim.compared, known.fit.offsets))
        held_out = WhitenedWindows(
            known.held_out, whitener(known.at_held_out, noise, sim.compared, known.held_out.offsets)
        )
    rows, each = np.random.default_rng(context.seed).permutation(len(fit.windows)), len(fit.windows) // len(known.fit)
    few, fewer = (each * max(30, int(n * possible)) for n in (s.screen_windows, s.scout_windows))
    return SearchWindows(noise, known, fit, fit[np.sort(rows[:few])], fit[np.sort(rows[:fewer])], held_out)


def measure_sensitivity(
    context: SearchContext, structure: ModelStructure, effects: Effects, noise: Noise
) -> WindowSensitivity:
    """Cut the windows and find out how they depend on their first states."""
    s, sim = context.settings, context.sim
    fit = cut_windows_for(context, structure.fixed, context.fit_episodes, s.fit_windows, context.seed + 1)
    held_out = cut_windows_for(
        context, structure.fixed, context.held_out_episodes, s.held_out_windows, context.seed + 2
    )
    left, coarser = sim.residual(effects, fit), context.with_coarse_numerics(effects, sim.control_period / 4)
    if coarser is not effects and not leave_the_same(noise, left, sim.residual(coarser, fit)):
        coarser = effects
    at = [initial_sensitivity(sim, coarser, w, noise.start) for w in (fit, held_out)]
    return WindowSensitivity(structure, left, fit, held_out, *at)


def leave_the_same(noise: Noise, left: np.ndarray, other: np.ndarray) -> bool:
    """Whether residuals (n, j, channels) are much the same, in units of the sensors' noise."""
    return bool(
        np.square((other - left) / noise.sensors).sum() < SAME_WHEN_COARSE * np.square(left / noise.sensors).sum()
    )


def still_hold(
    context: SearchContext, known: WindowSensitivity, structure: ModelStructure, effects: Effects, noise: Noise
) -> bool:
    """Whether sensitivities count for a model of another structure: while its predictions are near those before."""
    if known.structure == structure or known.structure.fixed != structure.fixed:
        return known.structure == structure
    W = whitener(known.at_fit, noise, context.sim.compared, known.fit.offsets)
    return moved_little(W, known.residual, context.sim.residual(effects, known.fit), SAME_SENSITIVITIES)


def cut_windows_for(context: SearchContext, fixed: Effects, episodes: np.ndarray, limit: int, seed: int) -> Windows:
    """At most ``limit`` windows of these episodes, fewer where they are expensive.

    Raises:
        ValueError: no episode is as long as a window.
    """
    limit = max(30, int(limit * affordable_windows(context, fixed)))
    windows = sample_windows(context.sim.data, episodes, context.steps, 5, limit, seed)
    if not len(windows):
        raise ValueError(f"no episode is as long as a window of {context.steps} control steps")
    return windows


def affordable_windows(context: SearchContext, fixed: Effects) -> float:
    """Share of the wanted windows that the time allows, by a nominal speed: no result may depend on a clock."""
    timestep = context.sim.compile(context.with_coarse_numerics(fixed)).opt.timestep
    per_window = context.horizon / timestep * SECONDS_PER_STEP
    simulations = sum(c.size + len(c.starts) for c in context.candidates)
    budget = context.settings.seconds / 12  # a screening takes a twelfth of the time
    return float(np.clip(budget / (simulations * per_window) / context.settings.scout_windows, 0.4, 1.0))

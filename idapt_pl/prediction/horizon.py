"""How long the windows are that predictions are judged by."""

from __future__ import annotations

import numpy as np

from idapt_pl.effects.actuators import ActuatorGain
from idapt_pl.prediction.data import Recording, UnusableData, Windows, sample_windows, slope_reach
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects, Simulator
from idapt_pl.prediction.whitening import initial_sensitivity, whiten, whitener

SHORTEST = 6
"""Control steps that the usual episode must last where only positions were measured."""

SHORTEST_WINDOW = 5
"""Control steps in a window at least, where episodes are long enough."""

WEAKER, SHOWN_ENOUGH = 0.9, 100.0
"""Motors so much weaker must show in the held-out windows by so many sigma², all together; else windows are doubled."""

WORTH_DOUBLING = 1.5
"""Times as much must they show in windows of twice the length."""

FEWEST_FITTED, FEWEST_JUDGED = 24, 8
"""Windows that must be left for that."""


def noise_windows(sim: Simulator, episodes: np.ndarray, seed: int) -> Windows:
    """Windows from which the noise is estimated: two control steps, or twice the reach of slopes that are velocities.

    Raises:
        UnusableData: the episodes are too short.
    """
    usual = int(np.median([len(sim.data[e]) for e in episodes]))
    steps = 2 if sim.velocities else min(2 * slope_reach(sim.data[0].time), usual)
    windows = sample_windows(sim.data, episodes, steps, 2, 200, seed + 3)
    if not len(windows) or not (sim.velocities or usual >= SHORTEST):
        raise UnusableData(
            f"the episodes are too short: half of them last {usual} control steps or fewer; "
            f"without measured velocities it takes {SHORTEST}"
        )
    return windows


def usable_episodes(data: list[Recording]) -> list[int]:
    """Numbers of the episodes that hold a window of the fewest control steps; all where none does.

    Gaps in a log leave fragments. They are often calm, and would be held out for it.
    """
    steps = min(SHORTEST_WINDOW, max(2, max(map(len, data)) // 2))
    every = range(len(data))
    return [e for e in every if len(sample_windows(data, np.array([e]), steps, 1, 1, 0))] or list(every)


def choose_horizon(
    sim: Simulator, declared: Effects, noise: Noise, splits: tuple[np.ndarray, np.ndarray], seed: int
) -> int:
    """Control steps in a window: about 0.1 s, or 0.25 s where samples are dense, but at least 5.

    With positions alone 0.25 s at least, and up to 0.5 s where that takes no more than 25 samples: what is not yet
    known of the velocity then hides what a servo does at first.

    Shorter, down to 5, where longer windows are few or the noise of the first state no longer goes through them
    linearly: contacts make them say little. Never longer than half of the episodes that are fitted or judged on.

    Args:
        sim: of the nominal model.
        declared: effects known already.
        noise: as it looks before anything is found.
        splits: episodes to fit and to judge on.
        seed: of the choice of windows.
    """
    dt = sim.control_period
    steps = max(SHORTEST_WINDOW, round(0.1 / dt))
    if dt < 0.01 or not sim.velocities:
        steps = max(steps, round(0.25 / dt))
    if not sim.velocities:
        steps = max(steps, min(25, round(0.5 / dt)))
    steps = int(min(steps, max(2, np.median([len(sim.data[e]) for e in np.concatenate(splits)]) // 2)))
    while steps > SHORTEST_WINDOW and not informative(sim, declared, noise, splits, steps, seed):
        steps = max(SHORTEST_WINDOW, steps // 2)
    return steps


def informative(
    sim: Simulator, effects: Effects, noise: Noise, splits: tuple[np.ndarray, np.ndarray], steps: int, seed: int
) -> bool:
    """Whether windows of so many control steps are many, and few residuals bend with the noise of the first state."""
    windows, held_out = (sample_windows(sim.data, episodes, steps, 5, 40, seed) for episodes in splits)
    if len(windows) < 40 or len(held_out) < 12:
        return False
    at = initial_sensitivity(sim, effects, windows, noise.start, draw=False)
    linear = np.square(at.slope * noise.start).sum(-1) + np.square(noise.sensors)
    return float(np.mean(np.square(at.bend * np.square(noise.start)).sum(-1) > 0.1 * linear)) < 0.1


def lengthen(
    sim: Simulator, effects: Effects, noise: Noise, splits: tuple[np.ndarray, np.ndarray], steps: int, seed: int
) -> int:
    """Control steps in a window, doubled as long as weaker motors do not show: of a slow machine, or a noisy log.

    Arguments as of :func:`choose_horizon`, and the control steps that it chose.
    """
    if not sim.model.nu:
        return steps
    shown = motors_show(sim, effects, noise, splits[1], steps, seed)
    while shown < SHOWN_ENOUGH:
        fitted, judged = (len(sample_windows(sim.data, part, 2 * steps, 5, 250, seed)) for part in splits)
        if fitted < FEWEST_FITTED or judged < FEWEST_JUDGED:
            break
        longer = motors_show(sim, effects, noise, splits[1], 2 * steps, seed)
        if longer < WORTH_DOUBLING * shown:
            break
        steps, shown = 2 * steps, longer
    return steps


def motors_show(sim: Simulator, effects: Effects, noise: Noise, episodes: np.ndarray, steps: int, seed: int) -> float:
    """What weaker motors change in forecasts of some episodes: sigma², all windows together; 0 where there are none."""
    windows = sample_windows(sim.data, episodes, steps, 5, 250, seed)
    if not len(windows):
        return 0.0
    W = whitener(initial_sensitivity(sim, effects, windows, noise.start), noise, sim.compared, windows.offsets)
    change = sim.residual((*effects, ActuatorGain("*", WEAKER)), windows) - sim.residual(effects, windows)
    return float(np.square(whiten(W, change)).sum())

"""From recordings to a search that has not looked for anything yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from datamodules import Trajectories
from idapt_pl.diagnosis.candidates.listing import all_candidates, in_plausible_ranges, typical_sizes
from idapt_pl.diagnosis.candidates.stops_shown import furthest_positions, is_shown, stops_shown
from idapt_pl.diagnosis.state.context import Progress, SearchContext
from idapt_pl.diagnosis.state.search_state import SearchState, first_state
from idapt_pl.diagnosis.state.settings import DEFAULT_SETTINGS, SearchSettings
from idapt_pl.effects.base import EFFECTS, Effect
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.end_stops import JointRange
from idapt_pl.effects.joints import JointBacklash
from idapt_pl.prediction.data import Recording, as_recordings
from idapt_pl.prediction.horizon import choose_horizon, lengthen, noise_windows, usable_episodes
from idapt_pl.prediction.model import name_elements
from idapt_pl.prediction.noise import Noise, estimate_noise
from idapt_pl.prediction.simulator import Simulator


def begin_search(
    model: mujoco.MjSpec, trajectories: Trajectories, declared: Sequence[Effect] = (),
    fit: Sequence[int] | None = None, hold_out: Sequence[int] | None = None, candidates: Sequence[str] | None = None,
    seed: int = 0, settings: SearchSettings = DEFAULT_SETTINGS, progress: Progress = lambda what, done: None,
    threads: int | None = None, unmeasured: Sequence[str] = (), noise: Noise | None = None,
) -> tuple[SearchContext, SearchState]:  # fmt: skip
    """A search that has not looked for anything yet. Arguments as for :func:`~idapt_pl.diagnosis.diagnose`."""
    model = name_elements(model.copy())
    data, velocities = as_recordings(model.copy().compile(), trajectories, may_lag=noise is None)
    splits = split_episodes(activity(data), fit, hold_out, usable_episodes(data))
    sim = Simulator(model, data, velocities, threads, unmeasured)
    return begin_with(sim, declared, splits, candidates, seed, settings, progress, noise)


def begin_with(
    sim: Simulator, declared: Sequence[Effect], splits: tuple[np.ndarray, np.ndarray],
    candidates: Sequence[str] | None, seed: int, settings: SearchSettings, progress: Progress, noise: Noise | None,
) -> tuple[SearchContext, SearchState]:  # fmt: skip
    """The same of a simulator, and of episodes to fit and to judge on."""
    declared = tuple(declared)
    probe = noise_windows(sim, splits[0], seed)
    first_noise = noise or estimate_noise(sim, declared, probe)
    steps = choose_horizon(sim, declared, first_noise, splits, seed)
    if noise is None:
        steps = lengthen(sim, declared, first_noise, splits, steps, seed)
    sizes = typical_sizes(sim.model, sim.data, steps * sim.control_period)
    sizes = replace(sizes, stops=furthest_positions(sim))
    begin = sim.spec_with([e for e in declared if not isinstance(e, JointBacklash)])  # that adds joints
    unlimited = choose_candidates(all_candidates(begin, sizes), candidates)
    every = in_plausible_ranges(sim.model, sizes, unlimited) if settings.plausible else unlimited
    ends, shown = [c for c in every if c.kind is JointRange], stops_shown(sim, declared)
    considered = [c for c in every if c.kind is not JointRange or is_shown(c, sim, shown)]
    without_ranges = unlimited if settings.plausible else ()
    context = SearchContext(
        sim, declared, considered, without_ranges, ends, *splits, steps, probe, noise, seed, settings, progress
    )
    return context, first_state(context, first_noise)


def activity(data: Sequence[Recording]) -> np.ndarray:
    """How lively each episode is: rms of its velocities, in units of what is usual for each of them; (episodes,)."""
    squares = np.stack([np.square(r.qvel).mean(0) for r in data])
    return np.sqrt((squares / (squares.mean(0) + 1e-12)).mean(1))


def split_episodes(
    lively: np.ndarray, fit: Sequence[int] | None, hold_out: Sequence[int] | None, usable: Sequence[int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Episodes to fit and to judge on.

    By default every fourth in the order of their liveliness is held out, so that both parts have calm and lively ones,
    whatever the order in which they were recorded.

    Args:
        lively: of each episode, as of :func:`activity`.
        fit: numbers of the episodes to fit on, if not all that are not held out.
        hold_out: numbers of the episodes to judge on, if not the others.
        usable: numbers of those that are long enough and not left out, if not all.

    Raises:
        ValueError: there is no such episode, one is in both parts, or none is left for one of them.
    """
    n, every = len(lively), np.arange(len(lively)) if usable is None else np.asarray(usable, int)
    for name, chosen in (("fit", fit), ("hold-out", hold_out)):
        for e in chosen or ():
            if not 0 <= e < n:
                raise ValueError(f"--{name}: there is no episode {e}; the recording has 0 to {n - 1}")
    if hold_out is not None:
        judged = np.asarray(hold_out, int)
    elif fit is not None:
        judged = np.setdiff1d(every, fit)
    else:
        judged = next(iter(quarters(lively, every)), np.zeros(0, int))
    fitted = np.setdiff1d(every, judged) if fit is None else np.asarray(fit, int)
    if both := np.intersect1d(fitted, judged).tolist():
        raise ValueError(f"episodes {both} are both to be fitted and held out")
    if not len(fitted) or not len(judged):
        lacking = "hold out" if len(fitted) else "fit"
        raise ValueError(
            f"{len(every)} of {n} episodes are long enough and not left out, which leaves none to {lacking}; at least "
            "two are needed"
        )
    return fitted, judged


def quarters(lively: np.ndarray, usable: np.ndarray) -> list[np.ndarray]:
    """Parts of the episodes that may be held out in turn, each with calm and lively ones; the first is the default.

    Args:
        lively: of each episode, as of :func:`activity`.
        usable: numbers of those that are long enough and not left out.

    Returns:
        Numbers of episodes: four parts that share none, or fewer where there are fewer than four episodes.
    """
    calmest = usable[np.argsort(lively[usable], kind="stable")]
    parts = [np.sort(calmest[(len(usable) // 2 + k) % 4 :: 4]) for k in range(4)]
    return [part for part in parts if len(part)]


def choose_candidates(found: Sequence[Candidate], names: Sequence[str] | None) -> list[Candidate]:
    """The candidates with these effect names (all for None).

    Raises:
        ValueError: no candidate has such a name, or the effect has nothing to act on; it says which there are.
    """
    if names is None:
        return list(found)
    known = sorted({c.kind.name for c in found})
    if unknown := sorted(set(names) - set(known)):
        what = "nothing for" if unknown[0] in EFFECTS else "unknown candidate"
        raise ValueError(f"{what} {unknown[0]!r}; this model has: {', '.join(known)}")
    return [c for c in found if c.kind.name in names]

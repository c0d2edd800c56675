"""The search: numerics, then round by round screen, confirm, accept; at the end revise and measure."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from datamodules import Trajectories
from idapt_pl.diagnosis.acceptance import accept, confirm
from idapt_pl.diagnosis.candidates import all_candidates, typical_sizes
from idapt_pl.diagnosis.data import Recording, Windows, as_recordings
from idapt_pl.diagnosis.model import name_elements
from idapt_pl.diagnosis.noise import Noise
from idapt_pl.diagnosis.numerics import retest_numerics
from idapt_pl.diagnosis.revision import eliminate_needless, swap_for_rivals
from idapt_pl.diagnosis.screening import screen_candidates, shortlist
from idapt_pl.diagnosis.search_state import Progress, Search, SearchSettings, Trial
from idapt_pl.diagnosis.simulator import Effects, Simulator
from idapt_pl.diagnosis.verdict import build_report
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.signals import ActuatorDelay, ActuatorLag
from idapt_pl.estimation.intervals import covariance, unknown_variance

DEFAULT_SETTINGS = SearchSettings()


@dataclass(frozen=True)
class Diagnosis:
    """The outcome; ``report`` is the content of ``report.json``."""

    report: dict
    effects: Effects
    declared: Effects
    sim: Simulator
    held_out: Windows
    tried: list[Trial]

    @property
    def verdict(self) -> str:
        """One of the four verdicts."""
        return self.report["verdict"]


def diagnose(
    model: mujoco.MjSpec,
    trajectories: Trajectories,
    declared: Sequence = (),
    fit: Sequence[int] | None = None,
    hold_out: Sequence[int] | None = None,
    candidates: Sequence[str] | None = None,
    seed: int = 0,
    settings: SearchSettings = DEFAULT_SETTINGS,
    progress: Progress = lambda what, share: None,
    threads: int | None = None,
    unmeasured: Sequence[str] = (),
    noise: Noise | None = None,
) -> Diagnosis:
    """Which physical effects does the model lack, by the recordings?

    Args:
        model: the nominal model.
        trajectories: measured episodes with ``qpos`` (and ``qvel``) and actions.
        declared: effects known already, applied throughout.
        fit: episodes to fit on; default three quarters, spread evenly.
        hold_out: episodes to judge on; default the others.
        candidates: names of the effects to consider; default all.
        seed: of the choice of windows.
        settings: how hard to look.
        progress: told what is being done.
        threads: for simulating; default all cores.
        unmeasured: joints whose positions in the recordings are made up: nothing is judged by them. The model's motion
            must not depend on where they are, only on how fast they move. Or ``"<joint> velocity"``, with which
            windows only begin.
        noise: of the sensors, where it is known; default is to estimate it from the recordings.

    Raises:
        UnusableData: the recordings do not fit the model.
        ValueError: an unknown candidate or episode.
    """
    started = time.perf_counter()
    search = begin_search(
        model, trajectories, declared, fit, hold_out, candidates, seed, settings, progress, threads, unmeasured, noise
    )
    tried = run_search(search)
    progress("judging", 0.95)
    report = build_report(search, tried)
    report["runtime_s"] = round(time.perf_counter() - started, 2)
    progress("done", 1.0)
    return Diagnosis(report, search.effects, search.declared, search.sim, search.held_out.windows, tried)


def begin_search(
    model: mujoco.MjSpec, trajectories: Trajectories, declared: Sequence = (), fit: Sequence[int] | None = None,
    hold_out: Sequence[int] | None = None, candidates: Sequence[str] | None = None, seed: int = 0,
    settings: SearchSettings = DEFAULT_SETTINGS, progress: Progress = lambda what, share: None, threads: int | None = None,
    unmeasured: Sequence[str] = (), noise: Noise | None = None,
) -> Search:  # fmt: skip
    """A search that has not looked for anything yet. Arguments as for :func:`diagnose`."""
    model = name_elements(model.copy())
    data, velocities = as_recordings(model.copy().compile(), trajectories, may_lag=noise is None)
    fit, hold_out = split_episodes(activity(data), fit, hold_out)
    sim = Simulator(model, data, velocities, threads, unmeasured)

    def considered(horizon: float) -> list[Candidate]:
        return choose_candidates(all_candidates(model, typical_sizes(sim.model, data, horizon)), candidates)

    return Search(sim, tuple(declared), fit, hold_out, considered, seed, settings, progress, noise)


def activity(data: list[Recording]) -> np.ndarray:
    """How lively each episode is: rms of its velocities, in units of what is usual for each of them; (episodes,)."""
    squares = np.stack([np.square(r.qvel).mean(0) for r in data])
    return np.sqrt((squares / (squares.mean(0) + 1e-12)).mean(1))


def split_episodes(
    lively: np.ndarray, fit: Sequence[int] | None, hold_out: Sequence[int] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Episodes to fit and to judge on.

    By default every fourth in the order of their liveliness is held out, so that both parts have calm and lively ones,
    whatever the order in which they were recorded.
    """
    n = len(lively)
    for name, chosen in (("fit", fit), ("hold-out", hold_out)):
        for e in chosen or ():
            if not 0 <= e < n:
                raise ValueError(f"--{name}: there is no episode {e}; the recording has 0 to {n - 1}")
    if hold_out is None:
        ranked = np.argsort(lively, kind="stable")
        hold_out = np.sort(ranked[n // 2 % 4 :: 4]) if fit is None else np.setdiff1d(ranked, fit)
    if fit is None:
        fit = np.setdiff1d(np.arange(n), hold_out)
    fit, hold_out = np.asarray(fit, int), np.asarray(hold_out, int)
    if shared := np.intersect1d(fit, hold_out).tolist():
        raise ValueError(f"episodes {shared} are both to be fitted and held out")
    if not len(fit) or not len(hold_out):
        raise ValueError(f"{n} episodes leave none to {'fit' if not len(fit) else 'hold out'}; at least two are needed")
    return fit, hold_out


def choose_candidates(found: list[Candidate], names: Sequence[str] | None) -> list[Candidate]:
    """The candidates with these effect names (all for None)."""
    if names is None:
        return found
    known = sorted({c.kind.name for c in found})
    if unknown := sorted(set(names) - set(known)):
        raise ValueError(f"unknown candidate {unknown[0]!r}; this model has: {', '.join(known)}")
    return [c for c in found if c.kind.name in names]


def run_search(search: Search) -> list[Trial]:
    """Greedy forward search with pruning; every acceptance is decided on episodes nothing was fitted to."""
    tried: list[Trial] = []
    retest_numerics(search)
    for k in range(search.settings.max_effects):
        share = 0.1 + 0.8 * k / search.settings.max_effects
        search.progress(f"round {k + 1}: screening", share)
        ranked = screen_candidates(search, k)
        search.progress(f"round {k + 1}: confirming", share + 0.06)
        chosen = shortlist(ranked, search.settings.confirm)
        for t in ranked:
            if t not in chosen:
                t.rejected_because = t.rejected_because or "its score in the screen is below those refitted"
        tried += ranked
        if accept(search, confirm(search, chosen)) is None:
            break
        search.renew()
        search.settle()
        retest_numerics(search)
    swap_for_rivals(search)
    eliminate_needless(search)
    measure_intervals(search)
    return tried


def measure_intervals(search: Search) -> None:
    """Fit once more, without shortcuts, and put intervals on the estimates."""
    if not search.found:
        return
    fit = search.refit(search.fit, search.accepted, search.x, 5)
    search.x, episodes = fit.x, search.fit.windows.episode
    V, clusters = covariance(fit, episodes), len(np.unique(episodes))
    by_chance = student.ppf(0.975, max(clusters - 1, 2)) * np.sqrt(np.maximum(np.diag(V), 0))
    width = np.hypot(by_chance, norm.ppf(0.975) * np.sqrt(unknown_variance(fit, search.systematic())))
    scale = np.concatenate([c.scale for c in search.accepted])
    sizes = np.cumsum([c.size for c in search.accepted])[:-1]
    for f, half in zip(search.found, np.split(width * scale, sizes), strict=True):
        if f.candidate.kind in (ActuatorDelay, ActuatorLag):  # when in a time step a command acts is convention
            half = half + 0.5 * search.sim.compile(search.fixed).opt.timestep
        low, high = f.candidate.bounds()
        f.interval = np.stack([np.maximum(f.x - half, low), np.minimum(f.x + half, high)], 1)

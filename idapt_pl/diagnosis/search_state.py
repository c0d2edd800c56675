"""Where a search stands: its settings, what was found and tried, the windows it fits and judges on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from idapt_pl.diagnosis.data import UnusableData, Windows, sample_windows
from idapt_pl.diagnosis.noise import (
    InitialStateSensitivity,
    Noise,
    estimate_noise,
    initial_sensitivity,
    whiten,
    whitener,
)
from idapt_pl.diagnosis.simulator import Effects, Simulator
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.least_squares import LeastSquaresFit, effects_of, gauss_newton, robust_loss

SECONDS_PER_STEP = 1e-5
"""Nominal cost of simulating one step of one window, about what small machines with contacts take on two cores."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how far along the diagnosis is, 0 to 1."""


@dataclass(frozen=True)
class SearchSettings:
    """How hard to look, and how sure to be.

    Args:
        max_effects: stop after so many.
        scout_windows: windows on which every candidate is scored.
        screened: candidates scored again on more windows.
        screen_windows: windows for that, and for the first refits.
        confirm: candidates refitted in each round.
        refined: of these, refitted once more without shortcuts and judged on held-out episodes.
        fit_windows: windows for fits of what was accepted.
        held_out_windows: windows to judge on.
        relative_gain: an effect must remove at least this share of the whole error (squared) ...
        removable_gain: ... and of what is above the noise floor.
        sureness: lower confidence bound of the held-out gain, in standard errors.
        z: of the score, in standard deviations under the null, family-wise.
        seconds: aim for no more than this on two cores.
        numerics: try other time steps and integrators too.
    """

    max_effects: int = 4
    scout_windows: int = 40
    screened: int = 16
    screen_windows: int = 100
    confirm: int = 8
    refined: int = 5
    fit_windows: int = 250
    held_out_windows: int = 250
    relative_gain: float = 0.02
    removable_gain: float = 0.05
    sureness: float = 1.2
    z: float = 4.5
    seconds: float = 60.0
    numerics: bool = True


@dataclass(eq=False)
class Trial:
    """What became of one candidate in one round.

    Attributes:
        candidate: the effect tried.
        round: counted from 0.
        score: squared whitened error that the linear screen expects it to remove, in units of what noise leaves.
        x: fitted parameters of the effects accepted before, then its own; after the screen alone its own only.
        losses: of each held-out window with it, (n,).
        gain: mean held-out loss without it minus with it.
        gain_error: standard error of that.
        rejected_because: empty for what was accepted.
    """

    candidate: Candidate
    round: int
    score: float
    x: tuple[np.ndarray, ...] = ()
    losses: np.ndarray | None = None
    gain: float = float("nan")
    gain_error: float = float("nan")
    rejected_because: str = ""

    @property
    def held_out(self) -> float:
        """Mean loss on held-out windows."""
        return float("nan") if self.losses is None else float(self.losses.mean())


@dataclass(eq=False)
class AcceptedEffect:
    """An accepted effect, with its estimate."""

    candidate: Candidate
    x: np.ndarray
    interval: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    equivalent: list[Trial] = field(default_factory=list)
    rivals: list[Trial] = field(default_factory=list)


@dataclass(frozen=True)
class WhitenedWindows:
    """Windows, with what whitens their residuals under the current model: (n, rows, residuals)."""

    windows: Windows
    W: np.ndarray

    def __getitem__(self, rows: np.ndarray) -> WhitenedWindows:
        return WhitenedWindows(self.windows[rows], self.W[rows])


@dataclass(frozen=True)
class WindowSensitivity:
    """Windows, and how they depend on their first states; ``under`` which numerics and found effects."""

    under: tuple
    fit: Windows
    held_out: Windows
    at_fit: InitialStateSensitivity
    at_held_out: InitialStateSensitivity


SHORTEST = 6
"""Control steps that the usual episode must last where only positions were measured."""


class Search:
    """A model in the making: the nominal one, what was declared, numerics and the effects found so far.

    Attributes:
        fixed: declared effects, and numerics if any were found.
        found: accepted effects.
        fit, screen, scout: windows of the fitted episodes, ever fewer of them.
        held_out: windows of the episodes that nothing is fitted to.
        noise: of the sensors, as given, or estimated under the current model.
    """

    noise: Noise
    fit: WhitenedWindows
    screen: WhitenedWindows
    scout: WhitenedWindows
    held_out: WhitenedWindows

    def __init__(
        self, sim: Simulator, declared: Effects, fit: np.ndarray, hold_out: np.ndarray,
        library: Callable[[float], list[Candidate]], seed: int, settings: SearchSettings, progress: Progress,
        noise: Noise | None = None,
    ) -> None:  # fmt: skip
        self.sim, self.settings, self.progress, self.seed = sim, settings, progress, seed
        self.fit_episodes, self.held_out_episodes = fit, hold_out
        self.declared = self.fixed = declared
        self.known_noise = noise
        self.found: list[AcceptedEffect] = []
        self.sensed: WindowSensitivity | None = None
        self.dt = float(np.median(np.diff(sim.data[0].time)))
        # slopes of positions look ahead: then only longer windows show the noise
        usual = int(np.median([len(sim.data[e]) for e in fit]))
        steps, samples = (2, 2) if sim.velocities else (min(max(2, round(0.25 / self.dt)), usual), 5)
        self.probe = sample_windows(sim.data, fit, steps, samples, 200, seed + 3)
        if not len(self.probe) or not (sim.velocities or usual >= SHORTEST):
            raise UnusableData(
                f"the episodes are too short: half of them last {usual} control steps or fewer; "
                f"without measured velocities it takes {SHORTEST}"
            )
        self.noise = noise or estimate_noise(sim, declared, self.probe)
        self.steps = self.choose_horizon()
        self.horizon = self.steps * self.dt
        self.candidates = library(self.horizon)
        self.renew()

    # --- the current model ------------------------------------------------------------------------

    @property
    def effects(self) -> Effects:
        """All effects of the current model."""
        return (*self.fixed, *effects_of(self.accepted, self.x))

    @property
    def accepted(self) -> list[Candidate]:
        """Candidates that were accepted."""
        return [f.candidate for f in self.found]

    @property
    def x(self) -> list[np.ndarray]:
        """Their parameters."""
        return [f.x for f in self.found]

    @x.setter
    def x(self, values: Sequence[np.ndarray]) -> None:
        for f, x in zip(self.found, values, strict=True):
            f.x = x

    # --- residuals --------------------------------------------------------------------------------

    def z(self, split: WhitenedWindows, effects: Effects) -> np.ndarray:
        """Whitened residuals, (n, rows)."""
        return whiten(split.W, self.sim.residual(effects, split.windows))

    def sketch(self, split: WhitenedWindows, effects: Effects) -> np.ndarray:
        """The same with numerics that are coarser and cheaper: good enough for a first look."""
        return self.z(split, self.coarse(effects))

    def loss(self, effects: Effects) -> np.ndarray:
        """Of every held-out window, (n,)."""
        return robust_loss(self.z(self.held_out, effects))

    def coarse(self, effects: Effects) -> Effects:
        """Effects with the model's own time step (a quarter of the control period at most) in place of a finer one."""
        if any(e.name == "numerics" for e in self.declared):
            return effects
        found, opt = next((e for e in effects if isinstance(e, Numerics)), None), self.sim.model.opt
        exact = found.timestep if found else float(opt.timestep)
        four = found.integrator == "RK4" if found else opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        step = min(float(opt.timestep), self.dt / 4)
        if (4 if four else 1) / exact < 1.5 / step:
            return effects
        return (*(e for e in effects if e is not found), Numerics("world", step, "implicitfast"))

    def refit(
        self, split: WhitenedWindows, candidates: Sequence[Candidate], x: Sequence[np.ndarray], iterations: int,
        fixed: Effects | None = None,
    ) -> LeastSquaresFit:  # fmt: skip
        """Fit candidates to a split."""
        fixed = self.fixed if fixed is None else fixed
        return gauss_newton(lambda e: self.z(split, e), fixed, candidates, x, iterations)

    def systematic(self) -> list[np.ndarray]:
        """What each systematic error of the sensors would change in the residuals fitted to, (n, rows) each."""
        now = self.z(self.fit, self.effects)
        return [self.z(self.fit, (*self.effects, error)) - now for error in self.noise.systematic]

    def settle(self) -> None:
        """Fit what was accepted, all together."""
        if self.found:
            self.x = self.refit(self.fit, self.accepted, self.x, 4).x

    # --- windows ----------------------------------------------------------------------------------

    def choose_horizon(self) -> int:
        """Control steps in a window: about 0.1 s, or 0.25 s where samples are dense, but at least 5.

        With positions alone 0.25 s at least, and up to 0.5 s where that takes no more than 25 samples: what is not yet
        known of the velocity then hides what a servo does at first.

        Shorter, down to 5, where longer windows are few or the noise of the first state no longer goes through them
        linearly: contacts make them say little. Never longer than half the episodes.
        """
        steps = max(5, round(0.1 / self.dt))
        if self.dt < 0.01 or not self.sim.velocities:
            steps = max(steps, round(0.25 / self.dt))
        if not self.sim.velocities:
            steps = max(steps, min(25, round(0.5 / self.dt)))
        steps = int(min(steps, max(2, np.median([len(r) for r in self.sim.data]) // 2)))
        while steps > 5 and not self.informative(steps):
            steps = max(5, steps // 2)
        return steps

    def informative(self, steps: int) -> bool:
        """Whether windows of so many control steps are many, and few residuals bend."""
        windows = sample_windows(self.sim.data, self.fit_episodes, steps, 5, 40, self.seed)
        held_out = sample_windows(self.sim.data, self.held_out_episodes, steps, 5, 40, self.seed)
        if len(windows) < 40 or len(held_out) < 12:
            return False
        at = initial_sensitivity(self.sim, self.effects, windows, self.noise.start)
        linear = np.square(at.slope * self.noise.start).sum(-1) + np.square(self.noise.sensors)
        return float(np.mean(np.square(at.bend * np.square(self.noise.start)).sum(-1) > 0.1 * linear)) < 0.1

    def affordable(self) -> float:
        """Share of the wanted windows that the time allows, by a nominal speed: no result may depend on a clock."""
        per_window = self.horizon / self.sim.compile(self.coarse(self.fixed)).opt.timestep * SECONDS_PER_STEP
        simulations = sum(c.size + len(c.starts) for c in self.candidates)
        budget = self.settings.seconds / 12  # a screening takes a twelfth of the time
        return float(np.clip(budget / (simulations * per_window) / self.settings.scout_windows, 0.4, 1.0))

    def cut(self, episodes: np.ndarray, limit: int, salt: int) -> Windows:
        """At most ``limit`` windows of these episodes, fewer where they are expensive."""
        windows = sample_windows(
            self.sim.data, episodes, self.steps, 5, max(30, int(limit * self.affordable())), self.seed + salt
        )
        if not len(windows):
            raise ValueError(f"no episode is as long as a window of {self.steps} control steps")
        return windows

    def renew(self) -> None:
        """Whiten again under the current model.

        Sensitivities to the first state are dear: they are kept while numerics and kinds of found effects are the same.
        """
        under = (self.fixed, tuple(c.label for c in self.accepted))
        if self.sensed is None or self.sensed.under != under:
            self.sensed = self.sense(under)
        s, rng, share = self.settings, np.random.default_rng(self.seed), self.affordable()
        seen = self.sensed
        self.noise = self.known_noise or estimate_noise(self.sim, self.effects, self.probe)
        self.fit = WhitenedWindows(seen.fit, whitener(seen.at_fit, self.noise, self.sim.compared))
        self.held_out = WhitenedWindows(seen.held_out, whitener(seen.at_held_out, self.noise, self.sim.compared))
        rows = rng.permutation(len(seen.fit))
        few, fewer = (max(30, int(n * share)) for n in (s.screen_windows, s.scout_windows))
        self.screen, self.scout = self.fit[np.sort(rows[:few])], self.fit[np.sort(rows[:fewer])]

    def sense(self, under: tuple) -> WindowSensitivity:
        """Cut the windows and find out how they depend on their first states."""
        s, sim, effects = self.settings, self.sim, self.effects
        fit = self.cut(self.fit_episodes, s.fit_windows, 1)
        held_out = self.cut(self.held_out_episodes, s.held_out_windows, 2)
        at = [initial_sensitivity(sim, effects, w, self.noise.start) for w in (fit, held_out)]
        return WindowSensitivity(under, fit, held_out, *at)

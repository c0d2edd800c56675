"""What stays the same throughout a search, and what the simulator says of a model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from idapt_pl.diagnosis.candidates.fit import CandidateFit, effects_of, fit_candidates
from idapt_pl.diagnosis.candidates.responses import Responses
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.effects.candidate import Candidate
from idapt_pl.effects.world import Numerics
from idapt_pl.estimation.least_squares import kept_in_line, robust_loss
from idapt_pl.prediction.data import Windows
from idapt_pl.prediction.force_windows import judges_forces
from idapt_pl.prediction.noise import Noise
from idapt_pl.prediction.simulator import Effects, Simulator
from idapt_pl.prediction.whitening import WhitenedWindows, whiten

SAME_WHEN_COARSE = 0.02
"""Share of what is left (squared) that a coarser time step may change in it."""

NUDGE, DIFFER_ALIKE = 0.02, 0.3
"""Of the usual velocities, by which first states are moved to see whether an integrator does; and the share (squared)
by which what that changes may differ in half of the windows. Where a strike leads to the next, it is more than all."""

FITS_ABOUT, WORTH_ANOTHER_FIT = 3, 0.005
"""Fits with a coarse time step one after the other at most, and the share of the loss that another must be about."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how far along the diagnosis is, 0 to 1."""


@dataclass(frozen=True, eq=False)
class SearchContext:
    """What stays the same throughout a search.

    Attributes:
        sim: of the nominal model, with the recordings.
        declared: effects known already, applied throughout.
        candidates: effects to consider, in the ranges of what is plausible.
        unlimited: the same without these ranges; empty where they have none.
        ends: of joints, which are tried where recordings show them to be stops; some of them are among the candidates.
        fit_episodes: numbers of the episodes to fit on.
        held_out_episodes: and of those to judge on; nothing is fitted to them.
        steps: control steps in a window.
        probe: short windows from which the noise is estimated.
        known_noise: of the sensors, where it is given: then it is not estimated.
        seed: of the choice of windows.
        settings: how hard to look.
        progress: told what is being done.
        responses: what candidates changed when they were last simulated on the scout windows.
        started: when the search began, by the clock that only tells durations, s.
    """

    sim: Simulator
    declared: Effects
    candidates: Sequence[Candidate]
    unlimited: Sequence[Candidate]
    ends: Sequence[Candidate]
    fit_episodes: np.ndarray
    held_out_episodes: np.ndarray
    steps: int
    probe: Windows
    known_noise: Noise | None
    seed: int
    settings: SearchSettings
    progress: Progress
    responses: Responses = field(default_factory=Responses)
    started: float = field(default_factory=time.perf_counter)

    @property
    def hurried(self) -> bool:
        """Whether only a quick look was asked for, and half of its time has passed."""
        return not self.settings.thorough and time.perf_counter() - self.started > self.settings.seconds / 2

    @property
    def horizon(self) -> float:
        """How long predictions run, s."""
        return self.steps * self.sim.control_period

    def whitened(self, split: WhitenedWindows, effects: Effects) -> np.ndarray:
        """Whitened residuals under some effects, (n, rows)."""
        return split.residual(self.sim, effects)

    def loss(self, split: WhitenedWindows, effects: Effects) -> np.ndarray:
        """Robust loss of every window, (n,)."""
        return robust_loss(self.whitened(split, effects))

    def fit(
        self,
        split: WhitenedWindows,
        fixed: Effects,
        candidates: Sequence[Candidate],
        x: Sequence[np.ndarray],
        iterations: int,
        exact: bool = False,
        slopes: np.ndarray | None = None,
        good_enough: float = np.inf,
    ) -> CandidateFit:
        """Fit candidates to windows. Arguments as of :func:`~idapt_pl.diagnosis.candidates.fit.fit_candidates`.

        Where a coarser time step predicts much the same from where the fit starts, what parameters change is simulated
        with it, and what the start leaves without, step by step (:meth:`_fit_about`). Else, where time steps finer than
        the model's own were found, slopes are measured with its own. Slopes that have to be ``exact`` are measured so.
        """
        start = (*fixed, *effects_of(candidates, x))
        own, step = float(self.sim.model.opt.timestep), 0.0 if exact else self.coarse_step(split, start)
        if step > own:
            found = self._fit_about(split, fixed, candidates, x, iterations, slopes, good_enough)
            if found is not None:
                return found

        def residual(effects: Effects) -> np.ndarray:
            return self.whitened(split, effects)

        def coarse(effects: Effects) -> np.ndarray:
            return self.whitened(split, self.with_coarse_numerics(effects, min(step, own)))

        cheaper = None if self.with_coarse_numerics(fixed, min(step, own)) is fixed else coarse
        everywhere = self.sim.side_by_side.map
        return fit_candidates(
            residual, fixed, candidates, x, iterations, exact, slopes, good_enough, cheaper, everywhere
        )

    def _fit_about(
        self,
        split: WhitenedWindows,
        fixed: Effects,
        candidates: Sequence[Candidate],
        x: Sequence[np.ndarray],
        iterations: int,
        slopes: np.ndarray | None,
        good_enough: float,
    ) -> CandidateFit | None:
        """A fit of what is :meth:`about` left, again from where it led as long as that takes away more.

        None where the first of these fits makes matters worse, without coarser time steps.
        """
        best: CandidateFit | None = None
        loss = float(self.loss(split, (*fixed, *effects_of(candidates, x))).mean())
        for again in range(FITS_ABOUT):
            residual = self.about(split, (*fixed, *effects_of(candidates, x)))
            fit = fit_candidates(
                residual, fixed, candidates, x, max(iterations - 3 * again, 2), slopes=slopes, good_enough=good_enough,
                everywhere=self.sim.side_by_side.map,
            )  # fmt: skip
            if fit.solution.given_up:
                return fit
            z = self.whitened(split, (*fixed, *effects_of(candidates, fit.x)))
            after = float(robust_loss(z).mean())
            if after >= loss and best is None:
                return None
            if after >= loss:
                break
            best = CandidateFit(fit.x, replace(fit.solution, loss=after, z=z))
            if after > (1 - WORTH_ANOTHER_FIT) * loss or abs(after - fit.solution.loss) < WORTH_ANOTHER_FIT * after:
                break
            x, slopes, loss = fit.x, fit.solution.J, after
        return best

    def about(self, split: WhitenedWindows, effects: Effects) -> Callable[[Effects], np.ndarray]:
        """What other effects leave, whitened, about: where a coarser time step will do.

        Then what they change is simulated with that, and what ``effects`` leave without. No window changes far more
        than others: with another step a foot may leave the ground where it stays.
        """
        step = self.coarse_step(split, effects)
        if self.with_coarse_numerics(effects, step) is effects:
            return lambda e: self.whitened(split, e)
        now, coarse = (self.whitened(split, e) for e in (effects, self.with_coarse_numerics(effects, step)))

        def changed(e: Effects) -> np.ndarray:
            change = self.whitened(split, self.with_coarse_numerics(e, step)) - coarse
            return kept_in_line(change.reshape(-1, 1), len(now)).reshape(now.shape)

        return lambda e: now + changed(e)

    def coarse_step(self, split: WhitenedWindows, effects: Effects) -> float:
        """Time step [s] that will do for what others change in predictions, at least the model's own.

        That is a quarter of the control period, where predictions under some effects are much the same with it. 0 where
        not even a cheaper integrator than the model's own does, as when feet and end stops make all differences grow.
        """
        longest, own = self.sim.control_period / 4, float(self.sim.model.opt.timestep)
        if judges_forces(split):
            return own
        now = self.whitened(split, effects)

        def does(step: float) -> bool:
            moved = self.whitened(split, self.with_coarse_numerics(effects, step)) - now
            return bool(np.square(moved).sum() < SAME_WHEN_COARSE * np.square(now).sum())

        if self.with_coarse_numerics(effects, longest) is effects:
            return own
        if does(longest):
            return longest
        finer_found = any(isinstance(e, Numerics) for e in effects)
        return own if finer_found or self.differ_alike(split, own) else 0.0

    def differ_alike(self, split: WhitenedWindows, step: float) -> bool:
        """Whether predictions from a moved first state differ as much with coarse numerics as with the model's own."""
        speed = np.sqrt(np.mean([np.square(r.qvel).mean(0) for r in self.sim.data], 0))
        nudge = NUDGE * np.concatenate([np.zeros_like(speed), speed])

        def differ(effects: Effects) -> np.ndarray:
            return whiten(
                split.W, self.sim.residual(effects, split.windows, nudge) - split.unwhitened(self.sim, effects)
            )

        coarse = self.with_coarse_numerics(self.declared, step)
        if coarse is self.declared:
            return True
        exact = differ(self.declared)
        wrong = np.square(differ(coarse) - exact).sum(1) / (np.square(exact).sum(1) + 1e-12)
        return float(np.median(wrong)) < DIFFER_ALIKE

    @property
    def numerics_declared(self) -> bool:
        """Whether time step and integrator are given, and not to be changed."""
        return any(e.name == Numerics.name for e in self.declared)

    def with_coarse_numerics(self, effects: Effects, longest_step: float | None = None) -> Effects:
        """Effects with a time step of a quarter of the control period in place of a finer one.

        Good enough for a first look. It is no longer than ``longest_step`` (default: the model's own; 0 for as it is).
        """
        if self.numerics_declared or longest_step == 0:
            return effects
        found, opt = next((e for e in effects if isinstance(e, Numerics)), None), self.sim.model.opt
        exact = found.timestep if found else float(opt.timestep)
        four = found.integrator == "RK4" if found else opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        step = min(longest_step or float(opt.timestep), self.sim.control_period / 4)
        if (4 if four else 1) / exact < 1.5 / step:
            return effects
        return (*(e for e in effects if e is not found), Numerics("world", step, "implicitfast"))

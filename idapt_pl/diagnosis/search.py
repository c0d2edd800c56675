"""The search: screen by simulating, confirm by refitting, accept on held-out episodes, prune, judge."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.stats import t as student

from datamodules import Trajectories
from idapt_pl.diagnosis.data import Windows, cut, recordings
from idapt_pl.diagnosis.library import Candidate, library, numerics, surroundings
from idapt_pl.diagnosis.simulator import Effects, Simulator
from idapt_pl.diagnosis.statistics import (
    Noise,
    covariance,
    effects_of,
    estimate_noise,
    gauss_newton,
    initial_sensitivity,
    paired_gain,
    whiten,
    whitener,
    window_loss,
)
from idapt_pl.diagnosis.verdict import judge
from idapt_pl.domains.paths import ActuatorDelay, ActuatorLag, SensingEffect

log = logging.getLogger(__name__)
SECONDS_PER_STEP = 1e-5
"""Nominal cost of simulating one step of one window, about what small machines with contacts take on two cores."""

Progress = Callable[[str, float], None]
"""Called with what is being done and how far along the diagnosis is, 0 to 1."""


@dataclass(frozen=True)
class Settings:
    """How hard to look, and how sure to be.

    Args:
        max_effects: stop after so many.
        confirm: candidates refitted in each round.
        screen_windows: windows for screening.
        fit_windows: windows for refits.
        final_windows: windows for the last fit and for judging held-out data.
        relative_gain: an effect must remove at least this share of the whole error (squared) ...
        removable_gain: ... and of what is above the noise floor.
        sureness: lower confidence bound of the held-out gain, in standard errors.
        z: of the score, in standard deviations under the null, family-wise.
        seconds: aim for no more than this on two cores.
    """

    max_effects: int = 4
    confirm: int = 8
    screen_windows: int = 150
    fit_windows: int = 250
    final_windows: int = 600
    relative_gain: float = 0.02
    removable_gain: float = 0.05
    sureness: float = 1.2
    z: float = 4.5
    seconds: float = 60.0


@dataclass
class Tried:
    """What became of one candidate in one round."""

    candidate: Candidate
    round: int
    score: float
    x: tuple[np.ndarray, ...] = ()
    held_out: float = float("nan")
    gain: float = float("nan")
    gain_error: float = float("nan")
    rejected_because: str = ""


@dataclass
class Found:
    """An accepted effect, with its estimate."""

    candidate: Candidate
    x: np.ndarray
    interval: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    error_after: float = float("nan")
    equivalent: list[Tried] = field(default_factory=list)
    rivals: list[Tried] = field(default_factory=list)


@dataclass
class Split:
    """Windows to fit and to judge on, with what whitens them under the current model."""

    windows: Windows
    W: np.ndarray

    def z(self, sim: Simulator, effects: Effects) -> np.ndarray:
        """Whitened residuals under some effects."""
        return whiten(self.W, sim.residual(effects, self.windows))


@dataclass
class State:
    """Where the search stands."""

    fixed: Effects  # declared effects and numerics
    found: list[Found]
    noise: Noise | None = None

    @property
    def effects(self) -> Effects:
        """All effects of the current model."""
        return (*self.fixed, *(f.candidate.effect(f.x) for f in self.found))


@dataclass(frozen=True)
class Diagnosis:
    """The outcome; ``report`` is the content of ``report.json``."""

    report: dict
    effects: Effects
    declared: Effects
    sim: Simulator
    held_out: Windows
    tried: list[Tried]

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
    settings: Settings = Settings(),
    progress: Progress = lambda what, share: None,
    threads: int | None = None,
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

    Raises:
        UnusableData: the recordings do not fit the model.
        ValueError: an unknown candidate or episode.
    """
    started = time.perf_counter()
    compiled = model.copy().compile()
    data, velocities = recordings(compiled, trajectories)
    fit, hold_out = split_episodes(len(data), fit, hold_out)
    sim = Simulator(model, data, velocities, threads)
    search = Search(sim, tuple(declared), fit, hold_out, candidates, seed, settings, progress)
    tried = search.run()
    progress("judging", 0.95)
    report = judge(search, tried)
    report["runtime_s"] = round(time.perf_counter() - started, 2)
    progress("done", 1.0)
    return Diagnosis(report, search.state.effects, tuple(declared), sim, search.held_out.windows, tried)


def split_episodes(n: int, fit: Sequence[int] | None, hold_out: Sequence[int] | None) -> tuple[np.ndarray, np.ndarray]:
    """Episodes to fit and to judge on; by default every fourth is held out, and half of a single one cannot be."""
    for name, chosen in (("fit", fit), ("hold-out", hold_out)):
        for e in chosen or ():
            if not 0 <= e < n:
                raise ValueError(f"--{name}: there is no episode {e}; the recording has 0 to {n - 1}")
    every = np.arange(n)
    if hold_out is None:
        left = every if fit is None else np.setdiff1d(every, fit)
        hold_out = left[len(left) // 2 % 4 :: 4] if fit is None else left
    if fit is None:
        fit = np.setdiff1d(every, hold_out)
    fit, hold_out = np.asarray(fit, int), np.asarray(hold_out, int)
    if shared := np.intersect1d(fit, hold_out).tolist():
        raise ValueError(f"episodes {shared} are both to be fitted and held out")
    if not len(fit) or not len(hold_out):
        raise ValueError(f"{n} episodes leave none to {'fit' if not len(fit) else 'hold out'}; at least two are needed")
    return fit, hold_out


class Search:
    """Greedy forward search with pruning; every acceptance is decided on episodes nothing was fitted to."""

    def __init__(
        self, sim: Simulator, declared: Effects, fit: np.ndarray, hold_out: np.ndarray,
        names: Sequence[str] | None, seed: int, settings: Settings, progress: Progress,
    ) -> None:  # fmt: skip
        self.sim, self.settings, self.progress, self.seed = sim, settings, progress, seed
        self.fit_episodes, self.held_out_episodes = fit, hold_out
        self.state = State(declared, [])
        self.declared = declared
        self.steps = self.choose_horizon()
        dt = float(np.median(np.diff(sim.data[0].time)))
        self.horizon = self.steps * dt
        self.candidates = choose(library(sim.spec, surroundings(sim.model, sim.data, self.horizon)), names)
        self.limit = self.affordable()
        self.renew()

    # --- windows ----------------------------------------------------------------------------------

    def choose_horizon(self) -> int:
        """Control steps in a window: at least 5 and about 0.1 s, and no longer than half the episodes."""
        dt = float(np.median(np.diff(self.sim.data[0].time)))
        steps = max(5, round(0.1 / dt))
        if dt < 0.01 or not self.sim.velocities:
            steps = max(steps, round(0.25 / dt))
        return int(min(steps, max(2, np.median([len(r) for r in self.sim.data]) // 2)))

    def affordable(self) -> float:
        """Share of the wanted windows that the time allows, by a nominal speed: no result may depend on a clock."""
        per_window = self.horizon / self.sim.compile(self.state.fixed).opt.timestep * SECONDS_PER_STEP
        simulations = sum(c.size + len(c.starts) for c in self.candidates)
        budget = self.settings.seconds / 6 / max(simulations, 1)  # a screening takes a sixth of the time
        return float(np.clip(budget / per_window / self.settings.screen_windows, 0.2, 1.0))

    def cut(self, episodes: np.ndarray, limit: int, salt: int) -> Windows:
        windows = cut(self.sim.data, episodes, self.steps, 5, max(30, int(limit * self.limit)), self.seed + salt)
        if not len(windows):
            raise ValueError(f"no episode is as long as a window of {self.steps} control steps")
        return windows

    def renew(self) -> None:
        """Whiten again under the current model: its noise, its sensitivity to the first state."""
        s, effects = self.settings, self.state.effects
        fit = self.cut(self.fit_episodes, s.fit_windows, 1)
        residual = self.sim.residual(effects, fit)
        S0 = initial_sensitivity(self.sim, effects, fit, residual)
        self.state.noise = estimate_noise(self.sim, residual, S0)
        self.fit = Split(fit, whitener(S0, self.state.noise))
        rows = np.random.default_rng(self.seed).permutation(len(fit))[: max(30, int(s.screen_windows * self.limit))]
        self.screen = Split(fit[np.sort(rows)], self.fit.W[np.sort(rows)])
        held = self.cut(self.held_out_episodes, s.final_windows // 2, 2)
        S0 = initial_sensitivity(self.sim, effects, held, self.sim.residual(effects, held))
        self.held_out = Split(held, whitener(S0, self.state.noise))

    # --- the rounds -------------------------------------------------------------------------------

    def run(self) -> list[Tried]:
        """Search until nothing passes. Returns all that was tried."""
        tried: list[Tried] = []
        self.retest_numerics()
        for k in range(self.settings.max_effects):
            share = 0.1 + 0.8 * k / self.settings.max_effects
            self.progress(f"round {k + 1}: screening", share)
            ranked = self.screening(k)
            self.progress(f"round {k + 1}: confirming", share + 0.06)
            chosen = shortlist(ranked, self.settings.confirm)
            confirmed = [self.confirm(t) for t in chosen]
            for t in ranked:
                if t not in chosen:
                    t.rejected_because = t.rejected_because or "its score in the screen is below those refitted"
            tried += ranked
            best = self.accept(confirmed)
            if best is None:
                break
            self.renew()
            self.refit()
            self.retest_numerics()
        self.swap()
        self.prune()
        self.finish()
        return tried

    def screening(self, round: int) -> list[Tried]:
        """Score every candidate by switching it on slightly (and at its starts); best first."""
        z = self.screen.z(self.sim, self.state.effects)
        weight = 1.0 / np.maximum(1.0, np.abs(z.ravel()) / 4.0)
        accepted = self.derivative([f.candidate for f in self.state.found], [f.x for f in self.state.found], z)
        root = np.sqrt(weight)
        Q = np.linalg.qr(accepted * root[:, None])[0] if accepted.shape[1] else np.zeros((z.size, 0))

        def clear(v: np.ndarray) -> np.ndarray:  # weighted, and orthogonal to what is accepted
            v = v * root[:, None]
            return v - Q @ (Q.T @ v)

        left = clear(z.reshape(-1, 1))
        variance = max(1.0, float(np.mean(np.square(left))))
        out = []
        for c in self.candidates:
            if any(f.candidate.label == c.label and f.candidate.names == c.names for f in self.state.found):
                continue
            low, high = c.bounds()
            D = clear(self.derivative([c], [np.array(c.nominal)], z))
            x, gain = best_step(D, left[:, 0], np.array(c.nominal), np.array(c.scale), low, high)
            start = x
            for s in c.starts:
                z_s = self.screen.z(self.sim, (*self.state.effects, c.effect(s)))
                secant = clear((z_s - z).reshape(-1, 1))[:, 0]
                norm = float(secant @ secant)
                if norm < 1e-12:
                    continue
                direct = float(np.square(left).sum() - np.square(left[:, 0] + secant).sum())
                if direct > gain:
                    gain, start = direct, np.array(s, float)
            score = gain / variance
            t = Tried(c, round, float(score), (start,))
            if score < self.settings.z**2 + 2 * c.size:
                t.rejected_because = f"score {score:.1f} is what noise alone gives"
            out.append(t)
        out.sort(key=lambda t: -(t.score - 2 * t.candidate.size))
        return out

    def derivative(self, candidates: Sequence[Candidate], x: Sequence[np.ndarray], z: np.ndarray) -> np.ndarray:
        """D z / d (x / scale) of candidates on the screening windows, on top of the current model."""
        columns = []
        for c, v in zip(candidates, x, strict=True):
            others = [
                e
                for e in self.state.effects
                if not (e.name == c.kind.name and e.target == c.target and c in [f.candidate for f in self.state.found])
            ]
            _, high = c.bounds()
            for k in range(c.size):
                moved, h = np.array(v, float), 0.05 * c.scale[k]
                h = -h if moved[k] + h > high[k] else h
                moved[k] += h
                columns.append((self.screen.z(self.sim, (*others, c.effect(moved))) - z).ravel() / 0.05 * np.sign(h))
        return np.stack(columns, 1) if columns else np.zeros((z.size, 0))

    def confirm(self, t: Tried) -> Tried:
        """Refit a candidate, with all accepted effects free, and see what it is worth on held-out episodes."""
        if t.rejected_because:
            return t
        found = self.state.found
        candidates = [f.candidate for f in found] + [t.candidate]
        fit = gauss_newton(
            self.sim,
            self.state.fixed,
            candidates,
            [*(f.x for f in found), t.x[0]],
            self.screen.windows,
            self.screen.W,
            5,
        )
        if len(self.fit.windows) > len(self.screen.windows):
            fit = gauss_newton(self.sim, self.state.fixed, candidates, fit.x, self.fit.windows, self.fit.W, 2)
        t.x = fit.x
        now = window_loss(self.held_out.z(self.sim, self.state.effects))
        after = window_loss(self.held_out.z(self.sim, (*self.state.fixed, *effects_of(candidates, fit.x))))
        t.held_out = float(after.mean())
        t.gain, t.gain_error = paired_gain(now, after, self.held_out.windows.episode)
        t.rejected_because = self.objection(t, now)
        return t

    def objection(self, t: Tried, now: np.ndarray) -> str:
        """Why a refitted candidate is not accepted, or nothing."""
        s, level = self.settings, float(now.mean())
        if t.gain - s.sureness * t.gain_error <= 0:
            return f"held-out gain {t.gain:.3g} ± {t.gain_error:.2g} is not surely positive"
        if t.gain < s.relative_gain * level:
            return (
                f"it removes {100 * t.gain / level:.1f} % of the held-out error, less than {100 * s.relative_gain:g} %"
            )
        if t.gain < s.removable_gain * max(level - 1.0, 0.0):
            above = 100 * t.gain / (level - 1)
            return f"it removes {above:.1f} % of what is above the floor, less than {100 * s.removable_gain:g} %"
        if t.round and t.gain < max(0.05 * level, 0.08):
            return f"as a further effect it removes {100 * t.gain / level:.1f} % of the held-out error, less than 5 %"
        if np.median(now) < 1.15 and t.gain < 0.15 * level:
            return "the typical window is at the noise floor already"
        return ""

    def accept(self, confirmed: list[Tried]) -> Found | None:
        """The best of those that passed: fewest parameters among those that are as good as the best."""
        passed = [t for t in confirmed if not t.rejected_because]
        if not passed:
            return None
        top = min(passed, key=lambda t: t.held_out + self.handicap(t))
        near = min(0.1 * max(top.gain, 0.0), 0.03 + 0.03 * top.held_out)
        close = [t for t in passed if t.held_out - top.held_out <= near]
        best = min(close, key=lambda t: (t.candidate.size, t.candidate.target == "*", t.held_out))
        for t in passed:
            if t is not best:
                t.rejected_because = (
                    f"{best.candidate.label} leaves less ({best.held_out:.3g} against {t.held_out:.3g})"
                )
        alike = [
            t for t in close if t is not best and abs(t.held_out - best.held_out) <= self.indistinguishable(best, t)
        ]
        found = Found(best.candidate, best.x[-1], equivalent=alike)
        for t in found.equivalent:
            t.rejected_because = f"as good as {best.candidate.label}: these data cannot tell them apart"
        found.rivals = sorted((t for t in confirmed if t.x and t is not best), key=lambda t: t.held_out)[:3]
        for f, x in zip(self.state.found, best.x[:-1], strict=True):
            f.x = x
        self.state.found.append(found)
        log.info("found %s = %s; held-out error %.3g", best.candidate.label, best.x[-1].round(4), best.held_out)
        return found

    def handicap(self, t: Tried) -> float:
        """Blaming sensors moves measurement and prediction alike, which imitates much: it must be clearly better."""
        return 0.05 * max(t.gain, 0.0) if issubclass(t.candidate.kind, SensingEffect) else 0.0

    def indistinguishable(self, a: Tried, b: Tried) -> float:
        """How far apart two held-out losses may be for the data not to tell the two candidates apart."""
        z = []
        for t in (a, b):
            candidates = [f.candidate for f in self.state.found] + [t.candidate]
            z.append(window_loss(self.held_out.z(self.sim, (*self.state.fixed, *effects_of(candidates, t.x)))))
        _, se = paired_gain(z[1], z[0], self.held_out.windows.episode)
        return max(2.0 * se, 0.005 * a.held_out)

    # --- keeping the model honest -------------------------------------------------------------------

    def refit(self, split: Split | None = None, iterations: int = 4):
        """All accepted effects together."""
        split = split or self.fit
        candidates = [f.candidate for f in self.state.found]
        if not candidates:
            return None
        fit = gauss_newton(
            self.sim, self.state.fixed, candidates, [f.x for f in self.state.found], split.windows, split.W, iterations
        )
        for f, x in zip(self.state.found, fit.x, strict=True):
            f.x = x
        return fit

    def retest_numerics(self) -> None:
        """Is it how the equations are integrated? Tried as discrete effects, again after every addition."""
        self.progress("numerics", 0.08)
        if any(e.name == "numerics" for e in self.declared):
            return
        others = tuple(e for e in self.state.fixed if e.name != "numerics")
        now_fit = window_loss(self.screen.z(self.sim, self.state.effects))
        best, best_loss = None, float(now_fit.mean())
        found, best_x = [f.candidate for f in self.state.found], ()
        for effect in numerics(self.sim.model):
            if effect in self.state.fixed:
                continue
            x = [f.x for f in self.state.found]
            if found:  # estimates shift with the integrator: compare after a refit
                x = gauss_newton(self.sim, (*others, effect), found, x, self.screen.windows, self.screen.W, 3).x
            loss = float(window_loss(self.screen.z(self.sim, (*others, effect, *effects_of(found, x)))).mean())
            if loss < 0.98 * now_fit.mean() and loss < 1.3 * best_loss:  # about as good: the finer one, tried later
                best, best_x, best_loss = effect, x, min(loss, best_loss)
        if best is None:
            return
        now = window_loss(self.held_out.z(self.sim, self.state.effects))
        after = window_loss(self.held_out.z(self.sim, (*others, best, *effects_of(found, best_x))))
        gain, error = paired_gain(now, after, self.held_out.windows.episode)
        level = float(now.mean())
        if gain - self.settings.sureness * error > 0 and gain > max(0.03 * level, 0.1 * max(level - 1.0, 0.0), 0.05):
            log.info("numerics: %s leaves %.3g of %.3g", best.to_dict()["parameters"], after.mean(), level)
            self.state.fixed = (*others, best)
            for f, x in zip(self.state.found, best_x, strict=True):
                f.x = x
            self.limit = self.affordable()
            self.renew()
            self.refit()

    def swap(self) -> None:
        """Was an early choice wrong, made before later effects and the numerics were known? Try its rivals again."""
        self.progress("trying rivals", 0.88)
        for f in self.state.found:
            rest = [g for g in self.state.found if g is not f]
            now = window_loss(self.held_out.z(self.sim, self.state.effects))
            best, best_loss, best_x = None, float(now.mean()), None
            for t in f.rivals:
                candidates = [*(g.candidate for g in rest), t.candidate]
                start = [*(g.x for g in rest), t.x[-1]]
                fit = gauss_newton(self.sim, self.state.fixed, candidates, start, self.fit.windows, self.fit.W, 4)
                after = window_loss(self.held_out.z(self.sim, (*self.state.fixed, *effects_of(candidates, fit.x))))
                gain, error = paired_gain(now, after, self.held_out.windows.episode)
                if after.mean() + self.handicap(t) < best_loss and gain > max(error, 0.03 * float(now.mean())):
                    best, best_loss, best_x = t, float(after.mean()), fit.x
            if best is not None:
                log.info("%s in place of %s: %.3g", best.candidate.label, f.candidate.label, best_loss)
                f.candidate, f.x, f.equivalent = best.candidate, best_x[-1], []
                for g, x in zip(rest, best_x[:-1], strict=True):
                    g.x = x
                self.renew()
                self.refit()
                self.retest_numerics()

    def prune(self) -> None:
        """Leave out again what the later effects have made needless."""
        self.progress("pruning", 0.9)
        for f in list(self.state.found):
            if len(self.state.found) < 2:
                return
            with_it = window_loss(self.held_out.z(self.sim, self.state.effects))
            rest = [g for g in self.state.found if g is not f]
            fit = gauss_newton(
                self.sim,
                self.state.fixed,
                [g.candidate for g in rest],
                [g.x for g in rest],
                self.fit.windows,
                self.fit.W,
                4,
            )
            effects = (*self.state.fixed, *effects_of([g.candidate for g in rest], fit.x))
            without = window_loss(self.held_out.z(self.sim, effects))
            gain, error = paired_gain(without, with_it, self.held_out.windows.episode)
            level = float(without.mean())
            if gain < self.settings.relative_gain * level or gain < self.settings.sureness * error:
                log.info("pruned %s: without it %.3g, with it %.3g", f.candidate.label, level, with_it.mean())
                for g, x in zip(rest, fit.x, strict=True):
                    g.x = x
                self.state.found = rest

    def finish(self) -> None:
        """Final fit on more windows, with intervals."""
        if not self.state.found:
            return
        s = self.settings
        windows = self.cut(self.fit_episodes, s.final_windows, 3)
        residual = self.sim.residual(self.state.effects, windows)
        S0 = initial_sensitivity(self.sim, self.state.effects, windows, residual)
        split = Split(windows, whitener(S0, self.state.noise))
        fit = self.refit(split, 5)
        V = covariance(fit, windows.episode)
        width = student.ppf(0.975, max(len(np.unique(windows.episode)) - 1, 2)) * np.sqrt(np.maximum(np.diag(V), 0))
        scale = np.concatenate([f.candidate.scale for f in self.state.found])
        at = 0
        for f in self.state.found:
            half = (width * scale)[at : at + f.candidate.size]
            if f.candidate.kind in (ActuatorDelay, ActuatorLag):  # when in a time step a command acts is convention
                half = half + 0.5 * self.sim.compile(self.state.fixed).opt.timestep
            low, high = f.candidate.bounds()
            f.interval = np.stack([np.maximum(f.x - half, low), np.minimum(f.x + half, high)], 1)
            at += f.candidate.size


def shortlist(ranked: list[Tried], size: int) -> list[Tried]:
    """The best ``size``, and the best of every other kind that scores a tenth of it: scores are only linear."""
    chosen = ranked[:size]
    kinds = {t.candidate.kind for t in chosen}
    for t in ranked[size:]:
        if t.candidate.kind not in kinds and t.score > 0.1 * ranked[0].score and not t.rejected_because:
            chosen.append(t)
            kinds.add(t.candidate.kind)
    return chosen


def choose(found: list[Candidate], names: Sequence[str] | None) -> list[Candidate]:
    """The candidates with these effect names (all for None)."""
    if names is None:
        return found
    known = sorted({c.kind.name for c in found})
    if unknown := sorted(set(names) - set(known)):
        raise ValueError(f"unknown candidate {unknown[0]!r}; this model has: {', '.join(known)}")
    return [c for c in found if c.kind.name in names]


def best_step(
    D: np.ndarray, left: np.ndarray, nominal: np.ndarray, scale: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """The least-squares step of a linear candidate inside its bounds, and how much squared error it removes."""
    H = D.T @ D
    step = -np.linalg.lstsq(H + 1e-9 * np.trace(H) * np.eye(len(H)) + 1e-300, D.T @ left, rcond=None)[0]
    x = np.clip(nominal + np.clip(step, -10, 10) * scale, low, high)
    moved = D @ ((x - nominal) / scale)
    return x, float(np.square(left).sum() - np.square(left + moved).sum())

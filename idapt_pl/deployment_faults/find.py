"""The tests for deployment faults, in order: repeated samples, velocities, then commands and joints by forecasts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from datamodules import Trajectories
from idapt_pl.deployment_faults.arriving import as_commands_arrive
from idapt_pl.deployment_faults.commands import Influence, measure_influence
from idapt_pl.deployment_faults.components import faults_of
from idapt_pl.deployment_faults.drives import drive_hypotheses, without_servo
from idapt_pl.deployment_faults.fault import DeploymentFault, FaultKind, FaultReport
from idapt_pl.deployment_faults.forecast import Gain, RecordingForecasts, Starts, gain_between
from idapt_pl.deployment_faults.hypotheses import (
    Hypothesis,
    command_hypotheses,
    first_of_each,
    gravity_hypotheses,
    joint_hypotheses,
    name_of,
    offset_hypotheses,
)
from idapt_pl.deployment_faults.mend import Mend, put
from idapt_pl.deployment_faults.offsets import offset_interval, refine_offset, small_offset
from idapt_pl.deployment_faults.sequence import SequenceFaults, find_sequence_faults, without_sequence_faults
from idapt_pl.deployment_faults.stale import without_stale_rows
from idapt_pl.deployment_faults.velocities import floating_period, velocity_mend
from idapt_pl.effects.own_signals import take_signals
from idapt_pl.prediction.data import measured_signals
from idapt_pl.prediction.model import name_elements, without_textures

LEAST_GAIN = 0.7
"""Log of the ratio of squared misses, without and with a mend, below which nothing is said."""

SIGMAS = 4.0
"""Standard errors that a gain must be above nothing, on episodes that the mend was chosen on and on the others."""

EQUALLY_GOOD = 0.05
"""Logs of squared misses, summed over degrees of freedom, that differ by less say nothing."""

MOST_ROUNDS = 12
"""Mends that are taken one after the other at most."""

SCREENED, REFINED = 48, 6
"""Forecasts by which hypotheses are ranked, and how many of the best are looked at with all of them."""

SMALL_DELAY, SMALL_DELAY_STEPS = 0.1, 3
"""Commands that act up to so many seconds, or control steps, late are a matter of physics: a delay, or a lag."""

FEWEST_STARTS = 24
"""Forecasts below which nothing is tested but repeated samples."""


SAID_OTHERWISE = {
    FaultKind.SERVO_AS_MOTOR: "servos read as motors",
    FaultKind.MOTOR_AS_SERVO: "motors read as servos",
    FaultKind.GRAVITY_TURNED: "direction of gravity",
}
"""What hypotheses are called whose faults are not of a channel."""


@dataclass(frozen=True)
class FaultSearch:
    """What stays the same in a search.

    Attributes:
        forecaster: of the recording.
        fit: where forecasts begin by which mends are chosen.
        held_out: and those by which they are judged.
        measured: whether velocities were measured.
    """

    forecaster: RecordingForecasts
    fit: Starts
    held_out: Starts
    measured: bool

    @classmethod
    def of(cls, model: mujoco.MjModel, data: Trajectories, measured: bool, period: float, seed: int) -> FaultSearch:
        """A search in a recording whose control period is off by a factor."""
        forecaster = RecordingForecasts(model, data, period, seed=seed)
        starts, even = forecaster.starts, forecaster.starts.block % 2 == 0
        return cls(forecaster, starts[even], starts[~even], measured)

    def gain(self, before: Mend, after: Mend, starts: Starts) -> Gain:
        """Of one mend over another."""
        misses = [self.forecaster.misses(m, starts) for m in (before, after)]
        return gain_between(misses[0], misses[1], starts.block)

    def moving(self, mend: Mend) -> list[int]:
        """Joints that move."""
        return self.forecaster.joints.moving(np.concatenate([s.qpos for s in self.forecaster.signals(mend)]))

    def best(self, hypotheses: Sequence[Hypothesis], starts: Starts | None = None) -> list[Hypothesis]:
        """The hypotheses under which forecasts miss least, in their order: those that are equally good."""
        starts = self.fit if starts is None else starts
        loss = [np.log(self.forecaster.misses(h.mend, starts).mean(0) + 1e-9).sum() for h in hypotheses]
        return [h for h, x in zip(hypotheses, loss, strict=True) if x < min(loss) + EQUALLY_GOOD]


def find_deployment_faults(
    model: mujoco.MjSpec,
    trajectories: Trajectories,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, done: None,
) -> FaultReport:
    """Is something wrong with a recording, before anything is said about physics?

    Args:
        model: the nominal model.
        trajectories: measured episodes with ``qpos`` (and ``qvel``) and actions.
        seed: of where forecasts begin.
        progress: told what is being done.

    Raises:
        UnusableData: the recordings do not fit the model.
    """
    started = time.perf_counter()
    plain, own = take_signals(name_elements(model.copy()))
    compiled = without_textures(plain).compile()
    measured = all(measured_signals(compiled, f"episode_{i}", e)[1] is not None for i, e in enumerate(trajectories))
    data, repeats = without_stale_rows(compiled, trajectories)
    found: list[DeploymentFault] = []
    if repeats:
        found.append(repeated_samples(repeats, sum(len(e) + 1 for e in trajectories)))
    sequence = find_sequence_faults(compiled, data)
    found += sequence_faults(sequence, data)
    data = as_commands_arrive(compiled, without_sequence_faults(data, sequence), own)
    mend = Mend.nothing(compiled)
    search = FaultSearch.of(compiled, data, measured, 1.0, seed) if 0 < data.dt < np.inf else None
    if search and min(len(search.fit), len(search.held_out)) >= FEWEST_STARTS:
        mend, others = find_mend(search, mend, progress)
        search = FaultSearch.of(compiled, data, measured, mend.period, seed + 1)
        mend = keep_certain(search, mend)
        found += measured_faults(search, mend, others)
    return FaultReport(tuple(found), mend, repeats > 0, sequence, compiled, round(time.perf_counter() - started, 2))


def repeated_samples(count: int, rows: int) -> DeploymentFault:
    """The fault of samples that repeat the one before."""
    return DeploymentFault(FaultKind.REPEATED_SAMPLES, ("*",), round(count / rows, 4), "share of the samples")


def sequence_faults(sequence: SequenceFaults, data: Trajectories) -> list[DeploymentFault]:
    """The faults of rows that are lost, out of order or not there yet."""
    rows = sum(len(e) + 1 for e in data)
    lost, swapped, started = sequence.counts
    told = (
        (FaultKind.REORDERED_SAMPLES, swapped, swapped / rows, "share of the samples"),
        (FaultKind.LOST_SAMPLES, lost, lost / (rows + lost), "share of the samples"),
        (FaultKind.WRONG_FIRST_SAMPLE, started, max(sequence.first, default=0), "samples"),
    )
    return [DeploymentFault(kind, ("*",), round(x, 4), unit) for kind, count, x, unit in told if count]


def find_mend(
    search: FaultSearch, mend: Mend, progress: Callable[[str, float], None]
) -> tuple[Mend, list[tuple[str, str]]]:
    """What makes forecasts surely and much better, one after the other; and what was taken for what else, in words."""
    progress("faults: velocities", 0.0)
    others: list[tuple[str, str]] = []
    f, moving = search.forecaster, search.moving(mend)
    if search.measured and moving:
        mend, others = velocity_mend(mend, f.signals, f.joints, moving, search.best)
    elif search.measured:
        mend = floating_period(mend, f.signals(mend), f.model)
    if mend.period != 1.0:
        search = FaultSearch.of(f.model, f.data, True, mend.period, 0)
    for round in range(MOST_ROUNDS):
        progress("faults: joints, commands", 0.01 + 0.005 * round)
        step = next_mend(search, mend)
        if step is None:
            break
        others += [(step[0].words, words) for words in step[1]]
        mend = step[0].mend
    return mend, others


def next_mend(search: FaultSearch, mend: Mend) -> tuple[Hypothesis, list[str]] | None:
    """The mend with one fault less, and what explains as much; None where nothing is certain."""
    f = search.forecaster
    delay: tuple[int, ...] = (0,) * f.model.nu
    tried: list[Hypothesis] = []
    if f.model.nu and not f.model.na:
        influence = measure_influence(f, mend, search.fit)
        period = f.data.dt * mend.period
        tried += clock_hypotheses(mend, influence, f.model, period)
        if 0 < influence.best <= allowed_delay(period):
            delay = (influence.best,) * f.model.nu
        tried += command_hypotheses(mend, influence, f.model, f.joints)
    moving = search.moving(mend)
    positions = np.concatenate([s.qpos for s in f.signals(mend)])[:, list(f.joints.q)]
    tried += joint_hypotheses(mend, f.model, f.joints, moving, np.ptp(positions, axis=0))
    tried += offset_hypotheses(mend, f.joints, moving)
    tried += gravity_hypotheses(mend, f.model)
    tried += certain_drives(search, mend)
    return choose_mend(search, mend, first_of_each(tried), delay)


def certain_drives(search: FaultSearch, mend: Mend) -> list[Hypothesis]:
    """Drives of another kind, where not even a motor with the same gain and friction would forecast as well."""
    made = []
    for h in drive_hypotheses(search.forecaster, mend, search.fit):
        if search.gain(without_servo(h.mend), h.mend, search.held_out).certain(LEAST_GAIN, SIGMAS) or not any(
            d and d[1] for d in h.mend.drives
        ):
            made.append(h)
    return made


def allowed_delay(period: float) -> int:
    """Control steps by which commands may act late without a fault."""
    return max(SMALL_DELAY_STEPS, int(SMALL_DELAY / period + 1e-6))


def clock_hypotheses(mend: Mend, found: Influence, model: mujoco.MjModel, period: float) -> Iterator[Hypothesis]:
    """Shifts in time of all commands and of single ones, near those measured; none that physics may explain."""
    largest = allowed_delay(period)

    def no_delay(s: int) -> bool:
        return s < 0 or s > largest

    for s in filter(no_delay, (found.best - 1, found.best, found.best + 1)):
        yield Hypothesis("clock of the commands", mend.delayed_commands((s,) * model.nu))
    for i in range(model.nu) if model.nu > 1 else ():
        for s in filter(no_delay, (found.own_late[i] - 1, found.own_late[i], found.own_late[i] + 1)):
            shift = put((0,) * model.nu, i, int(s))
            yield Hypothesis(f"clock of command {name_of(model, i)}", mend.delayed_commands(shift))


def choose_mend(
    search: FaultSearch, now: Mend, tried: Sequence[Hypothesis], delay: tuple[int, ...]
) -> tuple[Hypothesis, list[str]] | None:
    """The best hypothesis, if it is certain, and the words of those that are as good.

    Args:
        search: with the recording.
        now: the mend so far.
        tried: mends with one fault less.
        delay: of the commands in all forecasts, which is a matter of physics, (nu,).
    """
    few = search.fit[np.linspace(0, len(search.fit) - 1, min(SCREENED, len(search.fit))).astype(int)]
    misses = search.forecaster.misses

    def delayed(m: Mend) -> Mend:
        """The mend with the delay or without it, whichever forecasts better: a fault may look like a delay."""
        if m.u_late != now.u_late or not any(delay):
            return m
        return search.best([Hypothesis("", m), Hypothesis("", m.delayed_commands(delay))], few)[0].mend

    base = misses(delayed(now), few)
    scores = [gain_between(base, misses(delayed(h.mend), few), few.block).log_ratio for h in tried]
    best = [int(i) for i in np.argsort(-np.array(scores), kind="stable")[:REFINED] if scores[i] > 0.3 * LEAST_GAIN]
    if not best:
        return None
    chosen = [refine_offset(search.forecaster, tried[i], few) for i in sorted(best)]
    base = misses(delayed(now), search.fit)
    after = [misses(delayed(h.mend), search.fit) for h in chosen]
    gains = [gain_between(base, a, search.fit.block) for a in after]
    top = int(np.argmax([g.log_ratio for g in gains]))
    behind = [gain_between(a, after[top], search.fit.block) for a in after]
    as_good = [i for i, b in enumerate(behind) if b.log_ratio <= max(2 * b.error, 0.02) and not np.isinf(b.error)]
    first = as_good[0] if as_good else top
    held = search.gain(delayed(now), delayed(chosen[first].mend), search.held_out)
    sure = gains[first].certain(LEAST_GAIN, SIGMAS) and held.certain(LEAST_GAIN, SIGMAS)
    if not sure or small_offset(chosen[first].mend, now):
        return None
    words = [chosen[i].words for i in as_good if i != first and chosen[i].words != chosen[first].words]
    return chosen[first], words


def keep_certain(search: FaultSearch, mend: Mend) -> Mend:
    """The mend without what turns out to be needless beside the rest."""
    for _ in range(MOST_ROUNDS):
        parts = [
            p
            for p in faults_of(mend, search.forecaster.model, search.measured, search.forecaster.data.dt)
            if p.by_forecast
        ]
        gains = [search.gain(p.without, mend, search.held_out) for p in parts]
        weak = [i for i, g in enumerate(gains) if not g.certain(LEAST_GAIN / 2, SIGMAS / 2)]
        if not weak:
            return mend
        mend = parts[min(weak, key=lambda i: gains[i].log_ratio)].without
    return mend


def measured_faults(search: FaultSearch, mend: Mend, others: list[tuple[str, str]]) -> list[DeploymentFault]:
    """The faults that a mend takes out, with what each of them is worth."""
    found = []
    for part in faults_of(mend, search.forecaster.model, search.measured, search.forecaster.data.dt):
        gain = search.gain(part.without, mend, search.held_out)
        fault = replace(part.fault, gain=round(gain.log_ratio, 3), gain_error=round(gain.error, 3))
        if fault.kind is FaultKind.JOINT_ZERO:
            fault = replace(fault, ci95=offset_interval(search.forecaster, mend, fault.targets[0]))
        if fault.kind is FaultKind.COMMAND_CLOCK and isinstance(fault.estimate, float):
            half = search.forecaster.data.dt * mend.period / 2
            fault = replace(fault, ci95=(round(fault.estimate - half, 6), round(fault.estimate + half, 6)))
        found.append(fault)
    return with_alternatives(found, others)


def with_alternatives(found: list[DeploymentFault], others: list[tuple[str, str]]) -> list[DeploymentFault]:
    """Faults with what they could also be.

    Args:
        found: the faults.
        others: what was taken, and what was as good, in words.
    """
    also = [tuple(sorted({other for taken, other in others if is_told_by(f, taken)})) for f in found]
    return [replace(f, could_also_be=a) for f, a in zip(found, also, strict=True)]


def is_told_by(fault: DeploymentFault, words: str) -> bool:
    """Whether a hypothesis in words is about a fault."""
    if fault.kind in SAID_OTHERWISE:
        return SAID_OTHERWISE[fault.kind] == words
    about = all(part in words for part in fault.kind.value.replace("velocity", "velocit").split("_"))
    return about and (fault.targets == ("*",) or " the " in words or any(t in words for t in fault.targets))

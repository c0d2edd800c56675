"""From what a diagnosis left open to the next motion."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from idapt_pl.diagnosis.context import Progress
from idapt_pl.excitation.criterion import SeparationCriterion
from idapt_pl.excitation.design import Goal, MotionDesign, MotionSearch
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.limits import ImpossibleMotion, MotionLimits, servo_dof
from idapt_pl.excitation.motion import fourier_motion
from idapt_pl.excitation.rivals import LeftOpen, Rival

NOMINAL_COST = 1.5e-6
"""Nominal cost of one time step of one degree of freedom: no result may depend on a clock."""

FEWEST_MOTIONS = 96
"""Motions that are tried at least, however short the time."""


@dataclass(frozen=True)
class MotionPlan:
    """What is asked of a motion.

    Args:
        limits: to keep.
        duration: s.
        control_rate: of the commands, Hz; None for that of the recordings.
        fastest: highest frequency of the commands, Hz; None for what the control rate carries, at most 3.
        goal: what it is for.
        start: pose that it begins and ends at, (nq,); None for the model's first keyframe, or its zero pose.
        base: recorded commands that it is added to, (T, nu); then the duration is theirs.
        seconds: aim for about so long on one core.
        seed: of all random choices.
        rivals: tell so many explanations apart at most, what was found first.
    """

    limits: MotionLimits
    duration: float = 10.0
    control_rate: float | None = None
    fastest: float | None = None
    goal: Goal = Goal.SEPARATE
    start: np.ndarray | None = None
    base: np.ndarray | None = None
    seconds: float = 90.0
    seed: int = 0
    rivals: int = 6


def design_motion(
    left_open: LeftOpen, plan: MotionPlan, progress: Progress = lambda what, done: None, threads: int | None = None
) -> tuple[MotionDesign, Sequence[Rival], MotionForecaster]:
    """Find the motion that tells what was left open apart.

    Args:
        left_open: explanations of recordings.
        plan: what is asked.
        progress: told how far it is.
        threads: for simulating; default all cores.

    Returns:
        The motion, the explanations that it is about, and what simulates them.

    Raises:
        ImpossibleMotion: there is one explanation only, or no motion keeps the limits.
    """
    search, evaluations, rivals = prepare_search(left_open, plan, progress, threads)
    if plan.goal is Goal.SEPARATE and len(rivals) < 2:
        raise ImpossibleMotion(
            f"the report names one explanation alone ({rivals[0].name}), so there is nothing to tell apart; "
            "--goal estimate finds the motion that narrows its intervals"
        )
    return search.run(evaluations), rivals, search.criterion.forecast


def prepare_search(
    left_open: LeftOpen, plan: MotionPlan, progress: Progress = lambda what, done: None, threads: int | None = None
) -> tuple[MotionSearch, int, Sequence[Rival]]:
    """A search for a motion, how many the time allows it to try, and the explanations that it is about.

    Arguments as of :func:`design_motion`.

    Raises:
        ImpossibleMotion: the model does not rest at the start pose, or the motion is too short.
    """
    rivals = left_open.rivals[: plan.rivals]
    measurement = left_open.measurement
    model = left_open.spec.copy().compile()
    dt = 1 / plan.control_rate if plan.control_rate else measurement.control_period
    pose = start_pose(model) if plan.start is None else plan.start
    held = np.clip(holding_commands(model, pose), *plan.limits.command.T)
    around = np.tile(held, (max(2, round(plan.duration / dt)), 1)) if plan.base is None else plan.base
    if len(around) < 3 * measurement.window_steps:
        raise ImpossibleMotion(
            f"a motion of {len(around)} control steps is too short: a diagnosis compares windows of "
            f"{measurement.window_steps}; give a longer --duration"
        )
    fastest = min(0.15 / dt, 3.0) if plan.fastest is None else plan.fastest
    motion = fourier_motion(around, plan.limits.command, dt, fastest, plan.seed)
    forecaster = MotionForecaster(left_open.spec, rivals, pose, around[0], dt, measurement.velocities, threads)
    criterion = SeparationCriterion(forecaster, rivals, measurement)
    search = MotionSearch(criterion, motion, plan.limits, plan.goal, plan.seed, progress)
    return search, affordable_motions(forecaster, rivals, len(around), plan.seconds), rivals


def start_pose(model: mujoco.MjModel) -> np.ndarray:
    """The first keyframe, or the zero pose inside the joints' ranges, (nq,)."""
    if model.nkey:
        return model.key_qpos[0].copy()
    pose = model.qpos0.copy()
    for j in np.flatnonzero(model.jnt_limited):
        if model.jnt_type[j] >= 2:
            q = model.jnt_qposadr[j]
            pose[q] = np.clip(pose[q], *model.jnt_range[j])
    return pose


def holding_commands(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """Commands that hold a pose: its positions for servos, nothing for motors, (nu,)."""
    held = np.zeros(model.nu)
    for i in range(model.nu):
        if (v := servo_dof(model, i)) is not None:
            held[i] = pose[model.jnt_qposadr[model.dof_jntid[v]]]
    return held


def affordable_motions(forecaster: MotionForecaster, rivals: Sequence[Rival], steps: int, seconds: float) -> int:
    """Motions that the time allows, by a nominal speed."""
    model = forecaster.model
    per_step = NOMINAL_COST * (1 + model.nv / 2)
    simulations = 2 * len(rivals) + sum(c.size for r in rivals for c in r.candidates)
    per_motion = per_step * simulations * steps * forecaster.dt / model.opt.timestep
    return max(FEWEST_MOTIONS, int(0.7 * seconds / per_motion))


def read_base(path: Path, model: mujoco.MjModel, control_period: float) -> np.ndarray:
    """Recorded commands at the control rate, (T, nu): a table with time and a column for each actuator.

    Columns are known by the actuators' names, whatever follows them in brackets; a first column ``time`` is in seconds.

    Raises:
        ImpossibleMotion: a column is missing, or the file is no such table.
    """
    if not path.is_file():
        raise ImpossibleMotion(f"{path}: no such file; expected a table of commands (CSV)")
    with path.open(encoding="utf-8", newline="") as f:
        try:
            head, *rows = csv.reader(f)
            values = np.array(rows, float)
        except (ValueError, csv.Error, UnicodeDecodeError):
            raise ImpossibleMotion(f"{path}: expected a head with names and rows of as many numbers") from None
    names = [h.split("[")[0].strip() for h in head]
    wanted = ["time", *(model.actuator(i).name for i in range(model.nu))]
    if missing := [n for n in wanted if n not in names]:
        raise ImpossibleMotion(f"{path}: no column {missing[0]!r}; it has: {', '.join(names)}")
    if len(values) < 2 or not np.isfinite(values).all() or (np.diff(values[:, names.index("time")]) <= 0).any():
        raise ImpossibleMotion(f"{path}: expected two rows at least, finite numbers, and a time that increases")
    time = values[:, names.index("time")] - values[0, names.index("time")]
    at = np.searchsorted(time, control_period * np.arange(int(time[-1] / control_period + 1e-6)) + 1e-9, "right") - 1
    return values[at][:, [names.index(n) for n in wanted[1:]]]

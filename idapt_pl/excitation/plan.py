"""From what a diagnosis left open to the next motion."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from idapt_pl.diagnosis.candidates.held_joints import drives
from idapt_pl.diagnosis.state.context import Progress
from idapt_pl.excitation.criterion import SeparationCriterion
from idapt_pl.excitation.design import Goal, MotionDesign, MotionSearch
from idapt_pl.excitation.forecast import MotionForecaster
from idapt_pl.excitation.limits import ImpossibleMotion, MotionLimits, is_servo
from idapt_pl.excitation.motion import fourier_motion
from idapt_pl.excitation.rivals import LeftOpen, Rival

HELD_WITHIN = 1e-3
"""By how much a pose may differ from where a joint is held, rad or m: poses are typed."""

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
    model, still = left_open.spec.copy().compile(), left_open.held
    dt = 1 / plan.control_rate if plan.control_rate else measurement.control_period
    pose = start_pose(model, still) if plan.start is None else plan.start
    check_pose(model, pose, still)
    held = np.clip(holding_commands(model, pose), *plan.limits.command.T)
    around = np.tile(held, (max(2, round(plan.duration / dt)), 1)) if plan.base is None else plan.base
    window = measurement.window_steps * measurement.control_period
    if len(around) * dt < 3 * window:
        raise ImpossibleMotion(
            f"a motion of {len(around) * dt:.3g} s is too short: a diagnosis compares windows of {window:.3g} s, and "
            "three of them are the least; give a longer --duration"
        )
    fastest = min(0.15 / dt, 3.0) if plan.fastest is None else plan.fastest
    limits = with_held_joints(model, plan.limits, around[0], still)
    motion = fourier_motion(around, limits.command, dt, fastest, plan.seed)
    forecaster = MotionForecaster(
        left_open.spec, rivals, pose, around[0], dt, measurement.velocities, threads, tuple(still)
    )
    criterion = SeparationCriterion(forecaster, rivals, measurement)
    search = MotionSearch(criterion, motion, limits, plan.goal, plan.seed, progress)
    return search, affordable_motions(forecaster, rivals, len(around), plan.seconds), rivals


def with_held_joints(
    model: mujoco.MjModel, limits: MotionLimits, command: np.ndarray, held: Mapping[str, float]
) -> MotionLimits:
    """Limits of a motion in which held joints stay where they are, whatever their range.

    Nothing drove them in the recordings, and they may be free: what acts on them keeps the command of the start.

    Args:
        model: that holds them.
        limits: without that.
        command: at the start, (nu,).
        held: by name.
    """
    joints = [model.joint(name).id for name in held]
    kept = np.array([any(drives(model, i, j) for j in joints) for i in range(model.nu)], bool)
    position, velocity = limits.position.copy(), limits.velocity.copy()
    position[model.jnt_dofadr[joints]], velocity[model.jnt_dofadr[joints]] = (-np.inf, np.inf), np.inf
    commands = np.where(kept[:, None], command[:, None], limits.command)
    return replace(limits, position=position, velocity=velocity, command=commands)


def start_pose(model: mujoco.MjModel, held: Mapping[str, float] | None = None) -> np.ndarray:
    """The first keyframe, or the zero pose inside the joints' ranges; held joints where they are, (nq,)."""
    pose = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
    for j in np.flatnonzero(model.jnt_limited) if not model.nkey else ():
        if model.jnt_type[j] >= 2:
            q = model.jnt_qposadr[j]
            pose[q] = np.clip(pose[q], *model.jnt_range[j])
    for name, position in (held or {}).items():
        pose[model.joint(name).qposadr] = position
    return pose


def check_pose(model: mujoco.MjModel, pose: np.ndarray, held: Mapping[str, float]) -> None:
    """A pose must be one that the model can be in, with joints that are held where they are.

    Raises:
        ImpossibleMotion: naming the joint.
    """
    if not np.isfinite(pose).all():
        raise ImpossibleMotion(f"--start is {' '.join(f'{v:g}' for v in pose)}; expected {model.nq} finite numbers")
    for name, position in held.items():
        value = pose[model.joint(name).qposadr[0]]
        if abs(value - position) > HELD_WITHIN:
            raise ImpossibleMotion(
                f"--start puts joint {name} at {value:.3g}; it is held where the recordings have it, at {position:.3g}"
            )
    for j in np.flatnonzero(model.jnt_limited & (model.jnt_type >= 2)):
        value, (low, high) = pose[model.jnt_qposadr[j]], model.jnt_range[j]
        if not low <= value <= high and model.joint(j).name not in held:
            raise ImpossibleMotion(
                f"--start puts joint {model.joint(j).name or j} at {value:.3g}; its range is {low:.3g} to {high:.3g}"
            )


def holding_commands(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """Commands that hold a pose, (nu,): its positions, through their gears, for servos; for motors what weighs on them.

    The latter by inverse dynamics, as near as the motors come to it. Other actuators are told nothing.
    """
    data, held = mujoco.MjData(model), np.zeros(model.nu)
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    lengths, moments = data.actuator_length.copy(), moment_arms(model, data)
    data.qacc[:] = 0
    mujoco.mj_inverse(model, data)
    gain = model.actuator_gainprm[:, 0]
    servos = np.array([is_servo(model, i) for i in range(model.nu)], bool)
    held[servos] = lengths[servos]
    motors = np.flatnonzero(is_motor(model))
    if len(motors):
        forces = np.linalg.lstsq(moments[motors].T, data.qfrc_inverse, rcond=None)[0]
        held[motors] = forces / gain[motors]
    return held


def is_motor(model: mujoco.MjModel) -> np.ndarray:
    """Which actuators turn a command into a force, at once and by a fixed gain, (nu,)."""
    at_once = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
    fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    unbiased = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
    return np.asarray(at_once & fixed & unbiased & (model.actuator_gainprm[:, 0] != 0))


def moment_arms(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """What a unit of every actuator's force does at every degree of freedom, (nu, nv)."""
    arms = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return arms


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

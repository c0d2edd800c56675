"""Models that nobody here wrote, dm_control's and Gymnasium's, with one thing hidden, or nothing. One row a case.

    python benchmarks/suite_models.py --models hopper walker --seeds 30     # finished rows are kept
    python benchmarks/suite_models.py --summary

A body is heavier by six tenths, a joint is damped more, or a motor is weaker by a quarter: drawn by the seed, and
hidden in the compiled model, by no code of the effects. 16 episodes begin near the model's own start, under held random
commands and sums of sines in turn; positions have noise of 0.5 mm or mrad, velocities of 5 mm/s or mrad/s.
Writes results/suite_models.csv: ``right`` says that what is hidden is named, first or among what it could also be, and
nothing else is.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
import zlib
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from benchmarks.tables import read_rows, write_rows

from benchmarks.undeclared.models import ASSETS
from cli.provenance import git_commit
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.effects.compile_time import write_out_masses
from idapt_pl.effects.driven import joints_of_actuators
from idapt_pl.prediction.model import name_elements, read_model
from idapt_pl.tasks.dm_control_task import load_from_suite

FIELDS = (
    "model", "hidden", "seed", "truth", "value", "right", "found", "estimate", "covered", "verdict", "before", "after",
    "seconds", "commit",
)  # fmt: skip
TASKS = {
    "acrobot": "swingup", "ball_in_cup": "catch", "cartpole": "swingup", "cheetah": "run", "finger": "spin",
    "fish": "swim", "hopper": "hop", "humanoid": "walk", "manipulator": "bring_ball", "pendulum": "swingup",
    "point_mass": "easy", "quadruped": "walk", "stacker": "stack_2", "walker": "walk",
}  # fmt: skip
PERIODS = {"gym_ant": 0.05, "gym_humanoid": 0.015, "gym_half_cheetah": 0.05, "gym_swimmer": 0.04}
"""Gymnasium's, with their control periods, s."""
HIDDEN = ("nothing", "mass", "damping", "gain")
EPISODES, STEPS, HELD = 16, 80, 8
NOISE_Q, NOISE_V = 5e-4, 5e-3
SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


def model_of(name: str) -> tuple[mujoco.MjSpec, float]:
    """A published model, and its control period, s."""
    if name in PERIODS:
        return read_model(ASSETS / f"{name.removeprefix('gym_')}.xml"), PERIODS[name]
    env, xml, assets = load_from_suite(name, f"{name}/{TASKS[name]}", {})
    spec = name_elements(mujoco.MjSpec.from_string(xml, include=dict(assets), assets=dict(assets)))
    write_out_masses(spec)
    return spec, float(env.control_timestep())


def hide(model: mujoco.MjModel, what: str, rng: np.random.Generator) -> tuple[str, str, float]:
    """Change a compiled model; the effect, its target and the value that it then has."""
    if what == "mass":
        own = [b for b in range(1, model.nbody) if model.body_mass[b] > 1e-6 and model.body_dofnum[b]]
        b = rng.choice(own)
        model.body_mass[b] *= 1.6
        model.body_inertia[b] *= 1.6
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return "body_mass", model.body(b).name, float(model.body_mass[b])
    if what == "damping":
        j = rng.choice(bearings(model))
        v = model.jnt_dofadr[j]
        model.dof_damping[v] += max(1.5 * model.dof_damping[v], 3 * model.dof_M0[v])
        return "joint_damping", model.joint(j).name, float(model.dof_damping[v])
    if what == "gain":
        a = rng.integers(model.nu)
        if model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_AFFINE):  # a servo
            model.actuator_gainprm[a] *= 0.75
            model.actuator_biasprm[a] *= 0.75
            effect = "motor_strength" if model.actuator_biasprm[a, 2] else "actuator_kp"  # one without velocities
            return effect, model.actuator(a).name, 0.75
        model.actuator_gear[a] *= 0.75
        return "actuator_gain", model.actuator(a).name, 0.75
    return "", "", 0.0


def bearings(model: mujoco.MjModel) -> list[int]:
    """Hinges and slides that have a motor, or are alone on their body: no coordinates of a floating base."""
    driven = joints_of_actuators(model)
    scalar = [j for j in range(model.njnt) if model.jnt_type[j] in SCALAR]
    return [j for j in scalar if j in driven or model.body_jntnum[model.jnt_bodyid[j]] == 1]


def record(model: mujoco.MjModel, period: float, rng: np.random.Generator) -> Trajectories:
    """What a model does under random commands, seen with noise."""
    data, steps, made = mujoco.MjData(model), max(1, round(period / model.opt.timestep)), []
    limited = model.actuator_ctrllimited[:, None] > 0
    low, high = np.where(limited, model.actuator_ctrlrange, [-1.0, 1.0]).T
    for k in range(EPISODES):
        begin(model, data, rng)
        commands = low + (random_commands(model.nu, period, k, rng) + 1) / 2 * (high - low)
        q, v = [data.qpos.copy()], [data.qvel.copy()]
        for u in commands.astype(np.float32):
            data.ctrl[:] = u
            mujoco.mj_step(model, data, steps)
            q.append(data.qpos.copy()), v.append(data.qvel.copy())
        qpos, qvel = np.array(q), np.array(v)
        if np.isfinite(qpos).all():
            seen = {"qpos": noisy(model, qpos, rng), "qvel": qvel + NOISE_V * rng.normal(size=qvel.shape)}
            made.append(Episode(commands.astype(np.float32), seen))
    return Trajectories(tuple(made), steps * model.opt.timestep)


def begin(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator) -> None:
    """Near the model's own start, joints somewhere in three tenths of their range around it."""
    mujoco.mj_resetData(model, data)
    for j in np.flatnonzero(np.isin(model.jnt_type, SCALAR)):
        at = model.jnt_qposadr[j]
        low, high = model.jnt_range[j] if model.jnt_limited[j] else (data.qpos[at] - 1, data.qpos[at] + 1)
        data.qpos[at] += 0.3 * rng.uniform(-1, 1) * max(min(high - data.qpos[at], data.qpos[at] - low), 0.0)
    data.qvel[:] = 0.1 * rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)


def random_commands(nu: int, period: float, k: int, rng: np.random.Generator) -> np.ndarray:
    """Commands of an episode in parts of their range, (STEPS, nu): held in odd episodes, sums of three sines else."""
    if k % 2:
        return 0.7 * np.repeat(rng.uniform(-1, 1, (STEPS // HELD, nu)), HELD, 0)
    time = period * np.arange(STEPS)[:, None]
    waves = [np.sin(2 * np.pi * rng.uniform(0.3, 3, nu) * time + rng.uniform(0, 2 * np.pi, nu)) for _ in range(3)]
    return np.clip(0.35 * sum(waves), -1, 1)


def noisy(model: mujoco.MjModel, qpos: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Positions (T, nq) with noise, as rotations where they are such."""
    out = qpos.copy()
    for row in out:
        mujoco.mj_integratePos(model, row, NOISE_Q * rng.normal(size=model.nv), 1.0)
    return out


def run(name: str, what: str, seed: int) -> dict:
    """Hide, record, diagnose, compare."""
    spec, period = model_of(name)
    rng, true = np.random.default_rng([seed, zlib.crc32(f"{name} {what}".encode())]), spec.copy().compile()
    effect, target, value = hide(true, what, rng)
    data, started = record(true, period, rng), time.perf_counter()
    report = diagnose(spec, data, seed=seed).report
    physical = [e for e in report["effects"] if e["effect"] != "numerics"]
    names = [{(q["effect"], q["target"]) for q in (e, *e["equivalent"])} for e in physical]
    right = len(names) == 1 and (effect, target) in names[0] if effect else not names
    own = next((e for e in physical if (e["effect"], e["target"]) == (effect, target)), None)
    estimate = next(iter(own["parameters"].values())) if own else None
    low, high = estimate["ci95"] if estimate else (0.0, 0.0)
    return {
        "model": name, "hidden": what, "seed": seed, "truth": f"{effect}({target})" * bool(effect), "value": value,
        "right": int(right), "found": " ".join(f"{e['effect']}({e['target']})" for e in physical),
        "estimate": estimate["estimate"] if estimate else "", "covered": int(low <= value <= high) if estimate else "",
        "verdict": report["verdict"], **{k: report["error"][k] for k in ("before", "after")},
        "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row a kind of change."""
    lines = ["| hidden | cases | right | intervals that cover | median s |", "|---|---|---|---|---|"]
    for what in HIDDEN:
        if of := [r for r in rows if r["hidden"] == what]:
            covered = [int(r["covered"]) for r in of if r["covered"] != ""]
            seconds = np.median([float(r["seconds"]) for r in of])
            right = sum(int(r["right"]) for r in of)
            lines.append(f"| {what} | {len(of)} | {right} | {sum(covered)} of {len(covered)} | {seconds:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=["pendulum"], choices=[*TASKS, *PERIODS])
    p.add_argument("--hidden", nargs="+", default=HIDDEN, choices=HIDDEN)
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--summary", action="store_true", help="only print the table of what is there")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "suite_models.csv")
    o = p.parse_args()
    rows = {(r["model"], r["hidden"], int(r["seed"])): r for r in read_rows(o.out)}
    for key in [] if o.summary else itertools.product(o.models, o.hidden, o.seeds):
        if key not in rows:
            rows[key] = run(*key)
            write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
            print({k: rows[key][k] for k in FIELDS[:-1]}, flush=True)
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

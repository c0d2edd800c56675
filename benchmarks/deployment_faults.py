"""Are deployment faults found, alone and beside a physical effect, and none where there are none?

    python benchmarks/deployment_faults.py                  # all rows that are missing
    python benchmarks/deployment_faults.py --models reacher --seeds 2
    python benchmarks/deployment_faults.py --summary        # the tables of what is there

Recordings come from benchmarks/undeclared; faults are planted in them here, by code that shares nothing with the tests
for them. A row is right where exactly the planted fault is found. It is restored where the mended recording is the one
without the fault. Thresholds were chosen on ``TUNED`` models; the others were run when that was done. Every case of
benchmarks/undeclared is also looked at as it is, where anything found is a false alarm. Writes
results/deployment_faults.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from tables import read_rows, write_rows

from benchmarks.undeclared.cases import CASES
from benchmarks.undeclared.generate import generate, true_model
from benchmarks.undeclared.models import MODELS
from cli.provenance import git_commit
from datamodules import Episode, Trajectories, read_trajectories
from idapt_pl.deployment_faults import FaultReport, find_deployment_faults

FIELDS = (
    "part", "model", "case", "seed", "planted", "target", "found", "could_also_be", "right", "named",
    "restored", "false_alarm", "seconds", "commit",
)  # fmt: skip

TUNED = ("servo_arm", "half_cheetah")
BASES = {
    "servo_arm": ("control_servo_fine", "servo_gripper_mass"),
    "half_cheetah": ("control_cheetah_fine", "cheetah_bthigh_gain"),
    "pusher": ("control_pusher", "pusher_lift_gain"),
    "walker2d": ("control_walker_fine", "walker_leg_gain"),
    "reacher": ("control_reacher_implicit", "reacher_joint1_damping"),
    "hopper": ("control_hopper", "hopper_thigh_gain"),
    "swimmer": ("control_swimmer", "swimmer_rear_motor"),
    "inverted_pendulum": ("control_pendulum_fine", "pendulum_frictionloss"),
    "double_pendulum": ("control_double", "double_upper_mass"),
}
"""Without and with a physical effect, for each model."""

DEGREES = 180 / np.pi
GEAR = 50.0
Channels = dict[str, np.ndarray]
Plant = Callable[[Channels, mujoco.MjModel, np.random.Generator], str]
"""Edits qpos, qvel and actions of one episode in place (the generator is the same for each) and names the target."""


def pick(model: mujoco.MjModel, rng: np.random.Generator, count: int = 1) -> list[tuple[int, int, int]]:
    """Driven hinges, each as (actuator, column of its position, of its velocity)."""
    joints = model.actuator_trnid[:, 0]
    driven = [i for i in range(model.nu) if model.jnt_type[joints[i]] == 3] or list(range(model.nu))
    chosen = rng.choice(driven, min(count, len(driven)), replace=False)
    return [(int(i), int(model.jnt_qposadr[joints[i]]), int(model.jnt_dofadr[joints[i]])) for i in chosen]


def joint_sign(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """A joint counted the other way round."""
    ((i, q, v),) = pick(model, rng)
    x["qpos"][:, q] *= -1
    x["qvel"][:, v] *= -1
    return model.joint(int(model.actuator_trnid[i, 0])).name


def joint_unit(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """All hinges in degrees."""
    hinges = model.jnt_type == 3
    x["qpos"][:, model.jnt_qposadr[hinges]] *= DEGREES
    x["qvel"][:, model.jnt_dofadr[hinges]] *= DEGREES
    return "*"


def joint_unit_one(x: Channels, model: mujoco.MjModel, rng: np.random.Generator, factor: float = DEGREES) -> str:
    """One hinge alone in degrees, the others in rad."""
    ((i, q, v),) = pick(model, rng)
    x["qpos"][:, q] *= factor
    x["qvel"][:, v] *= factor
    return model.joint(int(model.actuator_trnid[i, 0])).name


def joint_counts(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """All hinges in counts of an encoder with 14 bits a turn."""
    hinges = model.jnt_type == 3
    x["qpos"][:, model.jnt_qposadr[hinges]] *= 16384 / (2 * np.pi)
    x["qvel"][:, model.jnt_dofadr[hinges]] *= 16384 / (2 * np.pi)
    return "*"


def joint_gear(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """One joint as its motor turns, in front of a gear of 50."""
    return joint_unit_one(x, model, rng, GEAR)


def joint_zero(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """A joint's zero elsewhere."""
    ((i, q, _),) = pick(model, rng)
    x["qpos"][:, q] += rng.choice([-1, 1]) * rng.uniform(0.4, 1.2)
    return model.joint(int(model.actuator_trnid[i, 0])).name


def joint_order(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Two joints exchanged."""
    a, b = pick(model, rng, 2)
    x["qpos"][:, [a[1], b[1]]] = x["qpos"][:, [b[1], a[1]]]
    x["qvel"][:, [a[2], b[2]]] = x["qvel"][:, [b[2], a[2]]]
    return " ".join(model.joint(int(model.actuator_trnid[i, 0])).name for i, _, _ in (a, b))


def velocity_sign(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """One velocity counted the other way round."""
    ((i, _, v),) = pick(model, rng)
    x["qvel"][:, v] *= -1
    return model.joint(int(model.actuator_trnid[i, 0])).name


def velocity_unit(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Velocities of all hinges in degrees per second."""
    x["qvel"][:, model.jnt_dofadr[model.jnt_type == 3]] *= DEGREES
    return "*"


def velocity_order(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Two velocities exchanged."""
    a, b = pick(model, rng, 2)
    x["qvel"][:, [a[2], b[2]]] = x["qvel"][:, [b[2], a[2]]]
    return " ".join(model.joint(int(model.actuator_trnid[i, 0])).name for i, _, _ in (a, b))


def velocity_clock(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Velocities two samples before the positions."""
    x["qvel"][:] = np.concatenate([x["qvel"][2:], x["qvel"][-1:], x["qvel"][-1:]])
    return "*"


def position_unit(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Positions of all hinges in degrees, velocities in rad/s."""
    x["qpos"][:, model.jnt_qposadr[model.jnt_type == 3]] *= DEGREES
    return "*"


def command_order(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """The commands the other way round."""
    x["actions"][:] = x["actions"][:, ::-1].copy()
    return "*"


def command_sign(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """One actuator wired the other way round."""
    i = int(rng.integers(model.nu))
    x["actions"][:, i] *= -1
    return model.actuator(i).name


def command_unit(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """All commands in degrees (servos) or per cent (motors)."""
    servo = model.actuator_biastype[0] == mujoco.mjtBias.mjBIAS_AFFINE
    x["actions"][:] *= DEGREES if servo else 100.0
    return "*"


def command_gear(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """All commands as torques in front of a gear of 50, or angles behind it."""
    x["actions"][:] /= GEAR
    return "*"


def command_clock(x: Channels, model: mujoco.MjModel, rng: np.random.Generator, steps: int = -2) -> str:
    """Commands noted two steps after they acted."""
    u = x["actions"]
    if steps < 0:
        u[-steps:] = u[:steps].copy()
    else:
        u[:-steps] = u[steps:].copy()
    return "*"


def command_clock_early(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Commands noted long before they acted: more than a tenth of a second, and more than three steps."""
    return command_clock(x, model, rng, max(4, int(0.1 / float(x["dt"]) + 1e-6) + 1) + 1)


def command_clock_one(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """One actuator's commands noted two steps late."""
    i = int(rng.integers(model.nu))
    x["actions"][2:, i] = x["actions"][:-2, i].copy()
    return model.actuator(i).name


def repeated_samples(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Every eighth sample is the one before."""
    for name in ("qpos", "qvel"):
        x[name][5::8] = x[name][4:-1:8].copy()[: len(x[name][5::8])]
    return "*"


def lost_samples(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Every seventeenth row is missing, with its command."""
    rows = np.arange(9, len(x["actions"]) - 3, 17)
    for name in ("qpos", "qvel", "actions"):
        x[name] = np.delete(x[name], rows, axis=0)
    return "*"


def reordered_samples(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """Every fifteenth sample is exchanged with the next."""
    for k in range(10, len(x["actions"]) - 3, 15):
        for name in ("qpos", "qvel"):
            x[name][[k, k + 1]] = x[name][[k + 1, k]]
    return "*"


def wrong_first_sample(x: Channels, model: mujoco.MjModel, rng: np.random.Generator) -> str:
    """The first two samples are zeros, from before the first message; positions begin elsewhere."""
    for name in ("qpos", "qvel"):
        x[name][:2] = 0
    return "*"


PLANTS: dict[str, Plant] = {
    f.__name__: f
    for f in (
        joint_sign, joint_unit, joint_zero, joint_order, velocity_sign, velocity_unit, velocity_order, velocity_clock,
        position_unit, command_order, command_sign, command_unit, command_clock, command_clock_early, command_clock_one,
        repeated_samples, lost_samples, reordered_samples, wrong_first_sample, joint_unit_one, joint_counts,
        joint_gear, command_gear,
    )
}  # fmt: skip
KINDS = {
    "command_clock_early": "command_clock", "command_clock_one": "command_clock", "joint_unit_one": "joint_unit",
    "joint_counts": "joint_unit", "joint_gear": "joint_unit", "command_gear": "command_unit",
}  # fmt: skip
NEED_TWO = ("joint_order", "velocity_order", "command_order", "command_clock_one")
NEED_HINGE = ("joint_unit_one", "joint_gear")
"""Of which a driven slide is none."""
PERIODS = {"control_period": 2.0}
MODELS_AT_FAULT = ("servo_as_motor", "motor_as_servo", "gravity_turned")
"""Faults of the nominal model."""


def faulty_model(spec: mujoco.MjSpec, data: Trajectories, name: str, seed: int) -> Trajectories:
    """Put a fault into the nominal model; the recordings that go with it."""
    gears = np.array([a.gear[0] for a in spec.actuators])
    limits = np.array([np.abs(a.ctrlrange).max() for a in spec.actuators])
    for actuator, gear, limit in zip(spec.actuators, gears, limits, strict=True):
        if name == "gravity_turned":
            break
        if name == "servo_as_motor":
            actuator.set_to_motor()
        else:  # a servo that would give the largest torque at half a radian
            actuator.set_to_position(kp=float(2 * gear * limit), kv=float(0.1 * gear * limit))
        actuator.gear, actuator.ctrllimited = np.eye(6)[0], mujoco.mjtLimited.mjLIMITED_FALSE
    if name == "motor_as_servo":  # torques in N·m
        episodes = [replace(e, actions=(e.actions * gears).astype(np.float32)) for e in data]
        data = replace(data, episodes=tuple(episodes))
    if name == "gravity_turned":
        rng, g = np.random.default_rng([seed, 7]), 9.81
        turned = [v for v in np.concatenate([np.eye(3), -np.eye(3)]) if v[2] > -0.5]
        spec.option.gravity = g * turned[int(rng.integers(len(turned)))]
    return data


def servo_world(case: str, seed: int, spec: mujoco.MjSpec) -> tuple[mujoco.MjSpec, Trajectories]:
    """A model whose motors have become servos, and recordings of it: of a case's true world with such servos.

    The recorded commands, from -1 to 1, are targets within half a radian. An actuator that is stronger in the true
    world is a stronger servo. Noise is white, as the model's.
    """
    world, nominal, about = true_model(CASES[case]), spec.compile(), MODELS[CASES[case].model]
    limits = np.abs(nominal.actuator_ctrlrange).max(1)
    kp = 2 * np.abs(nominal.actuator_gear[:, 0]) * limits
    true_kp = kp * np.abs(world.actuator_gear[:, 0] / nominal.actuator_gear[:, 0])
    world.actuator_gear[:] = np.eye(6)[0]
    world.actuator_biastype[:], world.actuator_ctrllimited[:] = int(mujoco.mjtBias.mjBIAS_AFFINE), 0
    world.actuator_gainprm[:, 0], world.actuator_biasprm[:, 1], world.actuator_biasprm[:, 2] = (
        true_kp, -true_kp, -0.1 * true_kp)  # fmt: skip
    for actuator, stiffness in zip(spec.actuators, kp, strict=True):
        actuator.set_to_position(kp=float(stiffness), kv=float(0.1 * stiffness))
        actuator.gear, actuator.ctrllimited = np.eye(6)[0], mujoco.mjtLimited.mjLIMITED_FALSE
    _, measured = generate(CASES[case], seed, ROOT / "runs" / "undeclared" / case / f"seed{seed}")
    data, rng, episodes = read_trajectories(measured), np.random.default_rng([seed, 11]), []
    every, state = round(data.dt / world.opt.timestep), mujoco.MjData(world)
    for e in data:
        targets = 0.5 * e.actions / limits
        mujoco.mj_resetData(world, state)
        state.qpos[:], state.qvel[:] = e.observations["qpos"][0], e.observations["qvel"][0]
        rows = [np.concatenate([state.qpos, state.qvel])]
        for u in targets:
            state.ctrl[:] = u
            mujoco.mj_step(world, state, every)
            rows.append(np.concatenate([state.qpos, state.qvel]))
        q, v = np.split(np.array(rows), [world.nq], axis=1)
        q, v = q + rng.normal(0, about.noise.qpos, q.shape), v + rng.normal(0, about.noise.qvel, v.shape)
        episodes.append(Episode(targets.astype(np.float32), {"qpos": q, "qvel": v}))
    return spec, replace(data, episodes=tuple(episodes))


def model_restored(report: FaultReport, faulty: mujoco.MjSpec, original: mujoco.MjModel, name: str) -> bool:
    """Whether the mended model is like the one without the fault: gravity, or the kind and strength of its drives."""
    model = report.fixed_model(faulty).compile()
    if name == "gravity_turned":
        return bool(np.allclose(model.opt.gravity, original.opt.gravity, atol=0.05))
    strength, true = (-m.actuator_biasprm[:, 1] for m in (model, original))
    if name == "motor_as_servo":
        return bool((strength == 0).all())
    return bool((np.abs(np.log(np.maximum(strength, 1e-9) / true)) < np.log(1.5)).all())


def planted(data: Trajectories, model: mujoco.MjModel, name: str, seed: int) -> tuple[Trajectories, str]:
    """Recordings with a fault, and what it is in."""
    if name in PERIODS:
        return replace(data, dt=data.dt * PERIODS[name]), "*"
    episodes, target = [], ""
    for e in data:
        x = {"qpos": e.observations["qpos"], "qvel": e.observations["qvel"], "actions": e.actions}
        x = {k: np.array(v, float) for k, v in x.items()} | {"dt": np.array(data.dt)}
        target = PLANTS[name](x, model, np.random.default_rng([seed, zlib.crc32(name.encode())]))
        episodes.append(Episode(x["actions"].astype(np.float32), {"qpos": x["qpos"], "qvel": x["qvel"]}))
    return replace(data, episodes=tuple(episodes)), target


def restored(report: FaultReport, faulty: Trajectories, original: Trajectories, name: str) -> bool:
    """Whether the mended recording is the one without the fault: a zero to 0.05 rad, gears to 10 %, repeats in part."""
    fixed = report.fixed(faulty)
    if abs(fixed.dt / original.dt - 1) > 0.01:
        return False
    if name == "lost_samples":
        steps, found = (sum(map(len, d)) for d in (original, faulty))
        return (
            abs(sum(int(x.sum()) for x in report.sequence.lost) / (steps - found) - 1) < 0.3
        )  # those lost at rest do not show
    if name == "wrong_first_sample":
        return all(len(e) == len(o) - 2 for e, o in zip(fixed, original, strict=True))
    first = report.mend.margins[0]
    allowed = {
        "joint_zero": 0.05,
        "joint_gear": 0.1,
        "command_gear": 0.1,
        "repeated_samples": 0.3,
        "reordered_samples": 1e-3,
    }.get(name, 1e-3)
    most = {"repeated_samples": 0.9, "reordered_samples": 0.95}.get(name, 1.0)
    for e, o in zip(fixed, original, strict=True):
        n = len(e)
        for now, then in (
            (e.actions, o.actions[first : first + n]),
            (e.observations["qpos"], o.observations["qpos"][first : first + n + 1]),
            (e.observations["qvel"], o.observations["qvel"][first : first + n + 1]),
        ):
            size = 1.0 if name == "joint_zero" else np.abs(then).max(0 if "gear" in name else None) + 1e-9
            off = np.abs(now - then) / size
            if np.quantile(off, most) > allowed:
                return False
    return True


def look(case: str, seed: int, name: str, folder: Path) -> dict:
    """One row: plant (nothing for an empty name), look, compare."""
    nominal, measured = generate(CASES[case], seed, folder / case / f"seed{seed}")
    spec, original = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    if name == "servo_as_motor" and CASES[case].model not in SERVOS:
        spec, original = servo_world(case, seed, spec)
    nominal_model = spec.compile()
    if name in MODELS_AT_FAULT:
        faulty, target = faulty_model(spec, original, name, seed), "*"
    else:
        faulty, target = planted(original, nominal_model, name, seed) if name else (original, "")
    started = time.perf_counter()
    report = find_deployment_faults(spec, faulty, seed)
    seconds = time.perf_counter() - started
    kinds = [f.kind.value for f in report.faults]
    row = {
        "part": "tuned" if CASES[case].model in TUNED else "held out", "model": CASES[case].model, "case": case,
        "seed": seed, "planted": name, "target": target,
        "found": " + ".join(f"{f.kind.value}({f.where})={f.value}" for f in report.faults),
        "could_also_be": "; ".join(w for f in report.faults for w in f.could_also_be),
        "seconds": round(seconds, 2), "commit": git_commit(),
    }  # fmt: skip
    if not name:
        return row | {"false_alarm": int(bool(kinds))}
    kind = KINDS.get(name, name)
    if name in MODELS_AT_FAULT:
        back = model_restored(report, spec, nominal_model, name)
    else:
        back = restored(report, faulty, original, name)
    what, _, how = kind.partition("_")
    named = len(report.faults) == 1 and any(what in w and how in w for w in report.faults[0].could_also_be)
    return row | {"right": int(set(kinds) == {kind} and back), "named": int(named), "restored": int(back)}


def wanted(models: Sequence[str], seeds: Sequence[int], plants: Sequence[str]) -> list[tuple[str, int, str]]:
    """Case, seed and fault of all rows."""
    rows = [(c, s, "") for c, case in CASES.items() if case.model in models for s in seeds if "" in plants]
    for model in models:
        few, weightless = MODEL_ACTUATORS.get(model, 2) < 2, model in LEVEL
        left_out = {*(NEED_TWO if few else ()), *(("gravity_turned",) if weightless else ())}
        left_out |= {"motor_as_servo"} if model in SERVOS else set() if model in MADE_SERVOS else {"servo_as_motor"}
        left_out |= set(NEED_HINGE) if model in SLIDE_DRIVEN else set()
        names = [p for p in plants if p and p not in left_out]
        rows += [(c, s, p) for c in BASES[model] for s in seeds for p in names]
    return rows


SERVOS = ("servo_arm",)
MADE_SERVOS = ("reacher", "pusher", "double_pendulum", "inverted_pendulum", "swimmer")
"""Models whose motors are made servos where servos are to be read as motors; others would fall or hit the ground."""
SLIDE_DRIVEN = ("inverted_pendulum", "double_pendulum")
LEVEL = ("reacher", "swimmer")
"""Models that move in a level plane, or in water: gravity does not show."""
MODEL_ACTUATORS = {"inverted_pendulum": 1, "double_pendulum": 1}


def summarise(rows: list[dict]) -> str:
    """Found, named as an alternative and missed by fault, and false alarms."""
    lines = []
    for part in ("tuned", "held out"):
        own = [r for r in rows if r["part"] == part]
        lines.append(f"--- {part}: {', '.join(sorted({r['model'] for r in own}))}")
        for name in (*PLANTS, *PERIODS, *MODELS_AT_FAULT):
            some = [r for r in own if r["planted"] == name]
            if some:
                right = sum(int(r["right"]) for r in some)
                named = sum(int(r["named"]) and not int(r["right"]) for r in some)
                silent = sum(not r["found"] for r in some)
                lines.append(f"{name:20s} right {right:3d}  one of two {named:3d}  silent {silent:3d}  of {len(some)}")
        alarms = [int(r["false_alarm"]) for r in own if not r["planted"]]
        seconds = [float(r["seconds"]) for r in own]
        if alarms:
            lines.append(f"false alarms         {sum(alarms)} of {len(alarms)}")
        if seconds:
            lines.append(f"seconds, median/max  {np.median(seconds):.1f} / {max(seconds):.1f}")
    return "\n".join(lines)


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", choices=list(BASES), default=list(BASES), metavar="MODEL")
    p.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES), metavar="CASE")
    p.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    p.add_argument(
        "--plants", nargs="*", default=["", *PLANTS, *PERIODS, *MODELS_AT_FAULT], metavar="FAULT", help="'' for none"
    )
    p.add_argument("--again", action="store_true", help="repeat rows that are there")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "undeclared")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "deployment_faults.csv")
    o = p.parse_args()
    rows = {(r["case"], int(r["seed"]), r["planted"]): r for r in read_rows(o.out)}
    for key in wanted(o.models, o.seeds, o.plants) if not o.summary else ():
        if key[0] not in o.cases or (key in rows and not o.again):
            continue
        rows[key] = r = {k: str(v) for k, v in look(*key, o.data).items()}
        told = f"right={r['right']}" if r["planted"] else f"alarm={r['false_alarm']}"
        print(f"{r['case']:28s} {r['seed']} {r['planted']:20s} {told} {r['seconds']:>6} s  {r['found']}", flush=True)
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

"""Is one hidden effect named on arms of 6 and 7 joints and on legged machines, and how does the time grow?

    pip download --no-deps robosuite==1.5.2 playground==0.2.0 && for f in *.whl; do unzip -qd published $f; done
    python benchmarks/large_machines.py --published published --seeds 0 1 2      # finished rows are kept
    python benchmarks/large_machines.py --summary                                # the table of what is there

The models are as published, read where they were unpacked, without pictures. Arms follow sines under a controller whose
torques are what is recorded; legs stand on the floor, with sines added to what their position servos hold. The truth is
made by writing numbers into the compiled model, at half the time step. Writes results/large_machines.csv: one row a
model, hidden effect and seed; ``nothing`` is a control.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from tables import read_rows, write_rows
from tqdm import tqdm

from cli.provenance import git_commit
from datamodules.trajectories import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "model", "joints", "effect", "seed", "truth", "found", "verdict", "right", "before", "after", "covered", "seconds",
    "threads", "commit",
)  # fmt: skip
KEY = ("model", "effect", "seed")
POSITION_NOISE, SPEED_NOISE = 5e-4, 5e-3


@dataclass(frozen=True)
class Machine:
    """A published model and how it is moved.

    Attributes:
        file: below the folder of what was unpacked.
        period: of control, s.
        seconds: of an episode.
        swing: of the sines on the joints, rad.
        middle: of the driven joints, (nu,).
        height: at which legs begin, m; None for arms.
        stiffness: of an arm's controller, per inertia of each joint, 1/s^2.
        episodes: recorded.
    """

    file: str
    period: float
    seconds: float
    swing: float
    middle: tuple[float, ...]
    height: float | None = None
    stiffness: float = 80.0
    episodes: int = 8


ARMS, LEGS = "robosuite/models/assets/robots", "mujoco_playground/_src/locomotion"
MACHINES = {
    "iiwa": Machine(f"{ARMS}/iiwa/robot.xml", 0.01, 4.0, 0.6, (0, 0.6, 0, -1.3, 0, 0.8, 0)),
    "ur5e": Machine(f"{ARMS}/ur5e/robot.xml", 0.01, 4.0, 0.6, (0, -1.2, 1.4, -0.8, 1.2, 0)),
    "kinova3": Machine(f"{ARMS}/kinova3/robot.xml", 0.01, 4.0, 0.6, (0, 0.6, 0, 1.3, 0, 0.8, 0)),
    "go1": Machine(f"{LEGS}/go1/xmls/go1_mjx_feetonly.xml", 0.02, 4.0, 0.25, (0, 0.9, -1.8) * 4, 0.28),
    "spot": Machine(f"{LEGS}/spot/xmls/spot_mjx_feetonly.xml", 0.02, 4.0, 0.12, (0, 0.9, -1.7) * 4, 0.5),
}


def nominal(machine: Machine, published: Path) -> mujoco.MjSpec:
    """The model as published, without meshes, materials and textures; legs on a floor of their own."""
    root = ET.parse(published / machine.file).getroot()
    for parent in list(root.iter()):
        for child in [c for c in parent if c.tag in ("asset", "sensor", "camera", "light")]:
            parent.remove(child)
        for child in [c for c in parent if c.tag == "geom" and (c.get("mesh") or c.get("class") == "visual")]:
            parent.remove(child)
        parent.attrib.pop("material", None)
    compiler = root.find("compiler")
    if compiler is not None:
        compiler.attrib.pop("meshdir", None)
    if machine.height is not None:
        floor = {"name": "floor", "type": "plane", "size": "0 0 0.05", "contype": "1", "conaffinity": "1"}
        ET.SubElement(root.find("worldbody"), "geom", floor)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.option.timestep = 0.002
    return spec


# --- what is hidden ---------------------------------------------------------------------------------------

Truth = tuple[set[tuple[str, str]], str, float | None]
"""Right answers (effect, target), and the parameter with its true value, where there is one to compare."""


def joint_of(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[str, int]:
    """A driven joint: its name and degree of freedom."""
    joint = int(model.actuator_trnid[rng.integers(model.nu), 0])
    return model.joint(joint).name, int(model.jnt_dofadr[joint])


def damping(model: mujoco.MjModel, rng: np.random.Generator) -> Truth:
    """A joint turns in thicker grease."""
    name, dof = joint_of(model, rng)
    model.dof_damping[dof] += 0.3 * torque_of(model, dof) / 3.0
    return {("joint_damping", name)}, "damping", float(model.dof_damping[dof])


def friction(model: mujoco.MjModel, rng: np.random.Generator) -> Truth:
    """A joint rubs."""
    name, dof = joint_of(model, rng)
    model.dof_frictionloss[dof] += 0.12 * torque_of(model, dof)
    return {("joint_frictionloss", name)}, "frictionloss", float(model.dof_frictionloss[dof])


def armature(model: mujoco.MjModel, rng: np.random.Generator) -> Truth:
    """A rotor that nobody modelled."""
    name, dof = joint_of(model, rng)
    model.dof_armature[dof] += 0.02 * torque_of(model, dof)
    return {("joint_armature", name)}, "armature", float(model.dof_armature[dof])


def payload(model: mujoco.MjModel, rng: np.random.Generator) -> Truth:
    """A heavier last link (arm) or trunk (legs), with the inertia of its mass."""
    body = int(model.jnt_bodyid[model.actuator_trnid[-1, 0]]) if model.jnt_type[0] != 0 else int(model.jnt_bodyid[0])
    factor = float(rng.uniform(1.5, 2.2))
    model.body_mass[body] *= factor
    model.body_inertia[body] *= factor
    name = model.body(body).name
    return {("body_mass", name), ("body_inertia", name)}, "mass", float(model.body_mass[body])


def gain(model: mujoco.MjModel, rng: np.random.Generator) -> Truth:
    """A motor (or, of a position servo, its stiffness) that is weaker than it should be."""
    i = int(rng.integers(model.nu))
    factor = float(rng.uniform(0.6, 0.8))
    model.actuator_gainprm[i, 0] *= factor
    servo = model.actuator_biasprm[i, 1] != 0
    model.actuator_biasprm[i, 1] *= factor
    name = model.actuator(i).name
    if servo:
        return {("actuator_kp", name)}, "kp", float(model.actuator_gainprm[i, 0])
    return {("actuator_gain", name)}, "gain", factor


def torque_of(model: mujoco.MjModel, dof: int) -> float:
    """Of the order of what a joint's motor does while the machine moves, N·m."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return float(np.clip(20.0 * M[dof, dof], 3.0 if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else 0.3, 40.0))


EFFECTS: dict[str, Callable[[mujoco.MjModel, np.random.Generator], Truth]] = {
    "damping": damping, "friction": friction, "armature": armature, "payload": payload, "gain": gain,
    "nothing": lambda model, rng: (set(), "", None),
}  # fmt: skip


# --- recording --------------------------------------------------------------------------------------------


def record(machine: Machine, plain: mujoco.MjModel, true: mujoco.MjModel, rng: np.random.Generator) -> Trajectories:
    """Episodes in the true world, as they would be measured."""
    return Trajectories(
        tuple(one_episode(machine, plain, true, rng) for _ in range(machine.episodes)), machine.period, "a recording"
    )


def one_episode(machine: Machine, plain: mujoco.MjModel, true: mujoco.MjModel, rng: np.random.Generator) -> Episode:
    """Sines on every joint, from rest."""
    data, steps = mujoco.MjData(true), round(machine.seconds / machine.period)
    driven = true.actuator_trnid[:, 0]
    coordinates, dofs = true.jnt_qposadr[driven], true.jnt_dofadr[driven]
    data.qpos[coordinates] = middle = np.array(machine.middle)
    if machine.height is not None:
        data.qpos[2] = machine.height
    wave = sines(machine, steps, len(driven), rng)
    qpos, qvel, actions = [], [], []
    substeps = round(machine.period / true.opt.timestep)
    for k in range(steps + 1):
        seen, speed = data.qpos.copy(), data.qvel + SPEED_NOISE * rng.standard_normal(true.nv)
        mujoco.mj_integratePos(true, seen, POSITION_NOISE * rng.standard_normal(true.nv), 1.0)
        qpos.append(seen)
        qvel.append(speed)
        if k == steps:
            break
        wanted = middle + wave[k]
        arm = machine.height is None
        command = torques(machine, plain, seen, speed, wanted, coordinates, dofs) if arm else wanted
        limited = true.actuator_ctrllimited.astype(bool)
        low, high = np.where(limited, true.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        actions.append(np.clip(command, low, high).astype(np.float32))
        data.ctrl[:] = actions[-1]
        mujoco.mj_step(true, data, substeps)
    return Episode(np.array(actions), {"qpos": np.array(qpos), "qvel": np.array(qvel)})


def sines(machine: Machine, steps: int, joints: int, rng: np.random.Generator) -> np.ndarray:
    """Three sines a joint, faded in, (steps, joints) rad."""
    t = machine.period * np.arange(steps)[:, None, None]
    frequency, phase = rng.uniform(0.3, 2.0, (3, joints)), rng.uniform(0, 2 * np.pi, (3, joints))
    wave = np.sin(2 * np.pi * frequency * t + phase).sum(1) / 3
    return machine.swing * wave * np.minimum(t[:, 0] / 0.5, 1.0)


def torques(
    machine: Machine, plain: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, wanted: np.ndarray,
    coordinates: np.ndarray, dofs: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """A computed-torque controller on the nominal model, (nu,)."""
    data = mujoco.MjData(plain)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(plain, data)
    M = np.zeros((plain.nv, plain.nv))
    mujoco.mj_fullM(plain, data, M)
    pull = np.zeros(plain.nv)
    pull[dofs] = machine.stiffness * (wanted - qpos[coordinates]) - 1.4 * np.sqrt(machine.stiffness) * qvel[dofs]
    return (M @ pull + data.qfrc_bias)[dofs] / plain.actuator_gear[:, 0]


# --- the benchmark ------------------------------------------------------------------------------------------


def run(name: str, effect: str, seed: int, published: Path, threads: int) -> dict:
    """Record, diagnose, compare."""
    machine, rng = MACHINES[name], np.random.default_rng([seed, *map(ord, name + effect)])
    spec = nominal(machine, published)
    plain, true = spec.compile(), spec.compile()
    answers, parameter, value = EFFECTS[effect](true, rng)
    true.opt.timestep /= 2
    data = record(machine, plain, true, rng)
    started = time.perf_counter()
    report = diagnose(spec, data, seed=seed, threads=threads).report
    seconds = time.perf_counter() - started
    found = [e for e in report["effects"] if e["effect"] != "numerics"]
    names = [{(e["effect"], e["target"]), *((q["effect"], q["target"]) for q in e["equivalent"])} for e in found]
    right = not found if not answers else len(found) == 1 and bool(names[0] & answers)
    return {
        "model": name, "joints": plain.nv, "effect": effect, "seed": seed,
        "truth": " or ".join(f"{e}({t})" for e, t in sorted(answers)) + (f" {parameter}={value:.4g}" if value else ""),
        "found": " + ".join(
            f"{e['effect']}({e['target']}) " + " ".join(f"{k}={p['estimate']}" for k, p in e["parameters"].items())
            for e in found
        ),
        "verdict": report["verdict"], "right": int(right), **{k: report["error"][k] for k in ("before", "after")},
        "covered": covers(found, answers, parameter, value), "seconds": round(seconds, 1), "threads": threads,
        "commit": git_commit(),
    }  # fmt: skip


def covers(found: list[dict], answers: set[tuple[str, str]], parameter: str, value: float | None) -> int | str:
    """Whether the interval holds the true value; empty where there is none to compare."""
    for e in found:
        if (e["effect"], e["target"]) in answers and parameter in e["parameters"] and value is not None:
            low, high = e["parameters"][parameter]["ci95"]
            return int(low <= value <= high)
    return ""


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row a model."""
    lines = ["| model | degrees of freedom | named, nothing besides | false alarms in controls | cover | median s |"]
    lines.append("|" + "---|" * 6)
    for name in MACHINES:
        of = [r for r in rows if r["model"] == name]
        cases, controls = ([r for r in of if (r["effect"] == "nothing") == c] for c in (False, True))
        if of:
            covered = [int(r["covered"]) for r in cases if r["covered"] != ""]
            lines.append(
                f"| {name} | {of[0]['joints']} | {sum(int(r['right']) for r in cases)} of {len(cases)} "
                f"| {sum(not int(r['right']) for r in controls)} of {len(controls)} "
                f"| {sum(covered)} of {len(covered)} | {np.median([float(r['seconds']) for r in of]):.0f} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--published", type=Path, help="folder in which robosuite and playground were unpacked")
    p.add_argument("--models", nargs="+", default=list(MACHINES), choices=list(MACHINES))
    p.add_argument("--effects", nargs="+", default=list(EFFECTS), choices=list(EFFECTS))
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--again", action="store_true", help="run finished rows again")
    p.add_argument("--summary", action="store_true", help="print the table of what is there, and run nothing")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "large_machines.csv")
    o = p.parse_args()
    rows = {(r["model"], r["effect"], int(r["seed"])): r for r in read_rows(o.out)}
    if not o.summary and (o.published is None or not o.published.is_dir()):
        raise SystemExit(f"--published must be the folder in which the models were unpacked; it is {o.published}")
    for key in tqdm([] if o.summary else list(itertools.product(o.models, o.effects, o.seeds)), unit="case"):
        if key in rows and not o.again:
            continue
        name, effect, seed = key
        rows[key] = run(name, effect, seed, o.published, o.threads)
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
        r = rows[key]
        tqdm.write(f"{key} right {r['right']}, {r['seconds']} s: {r['truth']}\n    -> {r['verdict']}: {r['found']}")
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

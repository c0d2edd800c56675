"""Are stretches in which a model cannot hold found, with their times, and is what is missing besides still found?

    python benchmarks/stretches.py --seeds 2 3               # all rows that are missing
    python benchmarks/stretches.py --models pendulum --seeds 0
    python benchmarks/stretches.py --undeclared --seeds 2    # cases of benchmarks/undeclared: nothing should be found
    python benchmarks/stretches.py --summary                 # the tables of what is there

A pendulum and an arm of two links are simulated here, by code that shares nothing with the diagnosis: in some episodes
(or in all) somebody pushes, the last link is caught at a point, the motors are off or brakes hold, for 0.3 to 1 s, with
and without an effect besides. ``found`` counts the planted stretches of which more than half was left out, ``wrong``
those left out where none was planted. ``right`` is that of the answer without them, ``right_with`` of the one with them
in. Thresholds were chosen on seed 0. Of the undeclared cases the model has what results/diagnosis.csv says was
found in them. Writes results/stretches.csv.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
import zlib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from tables import read_rows, write_rows

from benchmarks.undeclared.cases import CASES
from benchmarks.undeclared.generate import generate
from cli.provenance import git_commit
from datamodules import Episode, Trajectories, read_trajectories
from idapt_pl.prediction.data import as_recordings
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.simulator import Simulator
from idapt_pl.effects import Effect, effect_from_dict
from idapt_pl.effects.base import EFFECTS as KNOWN_EFFECTS
from idapt_pl.stretches import StretchReport, diagnose_stretches
from idapt_pl.stretches.find import find_stretches

FIELDS = (
    "part", "model", "event", "effect", "seed", "planted", "found", "wrong", "edge_s", "share", "verdict", "answer",
    "right", "verdict_with", "answer_with", "right_with", "seconds", "commit",
)  # fmt: skip
TUNED = (0,)
CANDIDATES = ("joint_damping", "joint_frictionloss", "actuator_gain", "joint_armature", "body_mass", "external_force")
"""Effects that are considered: those planted, and those that a push might be taken for."""

EPISODES, SECONDS, STEP, HELD = 8, 4.0, 0.002, 10
NOISE = 1e-3, 1e-2

LINK = '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 {z}" mass="{mass}" contype="0" conaffinity="0"/>'
PENDULUM = f"""<mujoco><option timestep="{STEP}"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" damping="0.05"/>{LINK.format(z=-0.4, mass=0.8)}</body></worldbody>
<actuator><motor name="hinge" joint="hinge" ctrlrange="-2 2"/></actuator></mujoco>"""
ARM = f"""<mujoco><option timestep="{STEP}"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.05"/>{LINK.format(z=-0.3, mass=0.6)}
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.03"/>{LINK.format(z=-0.25, mass=0.4)}
</body></body></worldbody><actuator><motor name="shoulder" joint="shoulder" ctrlrange="-3 3"/>
<motor name="elbow" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""
MODELS = {"pendulum": PENDULUM, "arm": ARM}
LAST = {"pendulum": ("hinge", "link", 0.4), "arm": ("elbow", "lower", 0.25)}
"""Joint, body and length of the last link."""

EVENTS = ("none", "push", "catch", "motors_off", "brake", "catch_every")
EFFECTS = {
    "none": None,
    "frictionloss": ("joint_frictionloss", 0.08),
    "gain": ("actuator_gain", 0.75),
    "damping": ("joint_damping", 0.15),
}
"""Of the last joint."""


@dataclass(frozen=True)
class Planted:
    """One stretch: episode, first and last (excluded) control step."""

    episode: int
    first: int
    last: int


def record(name: str, event: str, effect: str, seed: int) -> tuple[Trajectories, list[Planted]]:
    """Recordings, and what was planted in them."""
    rng = np.random.default_rng([seed, zlib.crc32(f"{name} {event} {effect}".encode())])
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    joint, body, length = LAST[name]
    dof = model.joint(joint).dofadr[0]
    if effect == "frictionloss":
        model.dof_frictionloss[dof] = EFFECTS[effect][1]
    if effect == "damping":
        model.dof_damping[dof] = EFFECTS[effect][1]
    if effect == "gain":
        model.actuator_gainprm[model.actuator(joint).id, 0] *= EFFECTS[effect][1]
    few = rng.choice(EPISODES, rng.integers(1, 4), replace=False)
    chosen = range(EPISODES) if event.endswith("every") else few if event != "none" else ()
    episodes, planted = [], []
    for i in range(EPISODES):
        stretch = None
        if i in chosen:
            steps = int(rng.uniform(0.3, 0.8 if event.endswith("every") else 1.0) / (STEP * HELD))
            first = int(rng.integers(25, SECONDS / (STEP * HELD) - steps - 5))
            stretch = Planted(i, first, first + steps)
            planted.append(stretch)
        episodes.append(simulate(model, body, length, event.split("_every")[0], stretch, rng))
    return Trajectories(tuple(episodes), STEP * HELD), planted


def simulate(
    model: mujoco.MjModel, body: str, length: float, event: str, stretch: Planted | None, rng: np.random.Generator
) -> Episode:
    """One episode: multisines, and from the first to the last step of the stretch what happens there."""
    data, T = mujoco.MjData(model), int(SECONDS / (STEP * HELD))
    data.qpos[:] = rng.normal(size=model.nq) * 0.4
    t = STEP * HELD * np.arange(T)[:, None, None]
    sines = np.sin(2 * np.pi * rng.uniform(0.3, 3.0, (model.nu, 4)) * t + rng.uniform(0, 6.3, (model.nu, 4))).sum(-1)
    actions = (0.35 * model.actuator_ctrlrange[:, 1] * sines).clip(*model.actuator_ctrlrange.T).astype(np.float32)
    push, anchor, rows = rng.uniform(2.0, 5.0) * rng.choice([-1, 1]), np.zeros(3), []
    link = model.body(body).id
    for k in range(T + 1):
        rows.append(np.concatenate([data.qpos, data.qvel]))
        if k == T:
            break
        now = stretch is not None and stretch.first <= k < stretch.last
        if now and k == stretch.first:
            anchor = tip(data, link, length)
        for _ in range(HELD):
            data.ctrl[:] = 0 if now and event in ("motors_off", "brake") else actions[k]
            data.qfrc_applied[:] = 0
            if now and event == "push":
                mujoco.mj_applyFT(model, data, np.array([push, 0, 0]), np.zeros(3), tip(data, link, length), link,
                                  data.qfrc_applied)  # fmt: skip
            if now and event == "catch":
                at, J = tip(data, link, length), np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, J, None, at, link)
                force = 400.0 * (anchor - at) - 6.0 * J @ data.qvel
                data.qfrc_applied[:] = J.T @ force
            if now and event == "brake":
                data.qfrc_applied[:] = -2.0 * data.qvel
            mujoco.mj_step(model, data)
    seen = np.array(rows)
    seen += rng.normal(size=seen.shape) * np.repeat(NOISE, [model.nq, model.nv])
    return Episode(actions, {"qpos": seen[:, : model.nq], "qvel": seen[:, model.nq :]})


def tip(data: mujoco.MjData, link: int, length: float) -> np.ndarray:
    """Where the last link ends."""
    return data.xpos[link] + data.xmat[link].reshape(3, 3) @ np.array([0, 0, -length])


def compare(planted: list[Planted], report: StretchReport) -> dict:
    """How many planted stretches were found, how many others, and how far edges are off."""
    found, edges, used = 0, [], set()
    for p in planted:
        best = [s for s in report.found if s.episode == p.episode and min(s.last, p.last) > max(s.first, p.first)]
        used |= {id(s) for s in best}
        covered = sum(min(s.last, p.last) - max(s.first, p.first) for s in best)
        if covered > (p.last - p.first) / 2:
            found += 1
            edges += [abs(min(s.first for s in best) - p.first), abs(max(s.last for s in best) - p.last)]
    wrong = sum(id(s) not in used for s in report.found)
    edge = round(float(np.mean(edges)) * STEP * HELD, 3) if edges else ""
    return {"planted": len(planted), "found": found, "wrong": wrong, "edge_s": edge, "share": round(report.share, 3)}


def right(answer: list[tuple[str, str]], verdict: str, effect: str, name: str) -> int:
    """Whether an answer is exactly what was planted; numerics do not count."""
    truth = EFFECTS[effect]
    named = [a for a in answer if a[0] != "numerics"]
    if truth is None:
        return int(not named and verdict == "no_missing_effect")
    targets = (LAST[name][0], *(("*", "actuated") if name == "pendulum" else ()))
    return int(verdict == "effects_found" and len(named) == 1 and named[0] in [(truth[0], t) for t in targets])


def look(name: str, event: str, effect: str, seed: int) -> dict:
    """One row."""
    data, planted = record(name, event, effect, seed)
    spec, started = mujoco.MjSpec.from_string(MODELS[name]), time.perf_counter()
    out, report = diagnose_stretches(lambda d: diagnose(spec, d, candidates=CANDIDATES, seed=seed, threads=1), data)
    answer = [e.key for e in out.result.effects]
    before = (list(report.with_them), report.verdict_with_them) if report.found else (answer, out.verdict.value)
    return {
        "part": "tuned" if seed in TUNED else "held out", "model": name, "event": event, "effect": effect, "seed": seed,
        **compare(planted, report), "verdict": out.verdict.value, "answer": told(answer),
        "right": right(answer, out.verdict.value, effect, name), "verdict_with": before[1],
        "answer_with": told(before[0]), "right_with": right(before[0], before[1], effect, name),
        "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip


def told(answer: list[tuple[str, str]]) -> str:
    """Effects in a cell."""
    return " + ".join(f"{e}({t})" for e, t in answer)


def effects_found(row: dict, model: mujoco.MjModel) -> tuple[Effect, ...]:
    """What results/diagnosis.csv says was found, as effects; what it does not list is as in the model."""
    values, made = row["estimate"].split(), []
    for part in filter(None, row["found"].split(" + ")):
        name, _, target = part.removesuffix(")").partition("(")
        known, parameters = {f.name for f in dataclasses.fields(KNOWN_EFFECTS[name])}, {}
        while values and (key := values[0].split("=")[0]) in known and key not in parameters:
            text = values.pop(0).split("=")[1]
            parameters[key] = text if key == "integrator" else float(text)
        defaults = {"numerics": {"timestep": model.opt.timestep, "integrator": "implicitfast"},
                    "gravity_direction": {"tilt_x": 0.0, "tilt_y": 0.0}}  # fmt: skip
        parameters = defaults.get(name, {}) | parameters
        made.append(effect_from_dict({"effect": name, "target": target, "parameters": parameters}))
    return tuple(made)


def look_at_undeclared(case: str, seed: int, folder: Path, found: dict) -> dict:
    """One row of a case in which no stretch is planted, under the model with what was found of it."""
    nominal, measured = generate(CASES[case], seed, folder / case / f"seed{seed}")
    spec, started = mujoco.MjSpec.from_file(str(nominal)), time.perf_counter()
    data, velocities = as_recordings(spec.copy().compile(), read_trajectories(measured))
    sim = Simulator(spec, data, velocities, 1)
    stretches, _ = find_stretches(sim, effects_found(found, sim.model))
    share = sum(s.last - s.first for s in stretches) / sum(map(len, data))
    return {
        "part": "undeclared", "model": CASES[case].model, "event": "none", "effect": case, "seed": seed, "planted": 0,
        "found": 0, "wrong": len(stretches), "share": round(share, 4), "verdict": found["verdict"],
        "answer": found["found"], "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """Found and missed by event; answers right with and without what was left out; false alarms."""
    lines = []
    for part in ("tuned", "held out"):
        own = [r for r in rows if r["part"] == part]
        for event in EVENTS:
            some = [r for r in own if r["event"] == event]
            if not some:
                continue
            planted, found, wrong = (sum(int(r[k]) for r in some) for k in ("planted", "found", "wrong"))
            edges = [float(r["edge_s"]) for r in some if r["edge_s"] != ""]
            edge = f"edges off by {np.mean(edges):.3f} s" if edges else ""
            good, before = (sum(int(r[k]) for r in some) for k in ("right", "right_with"))
            lines.append(
                f"{part:9s} {event:12s} found {found:3d} of {planted:3d}, wrong {wrong}, answer right {good:2d} of "
                f"{len(some)} (with them in {before:2d}) {edge}"
            )
    if own := [r for r in rows if r["part"] == "undeclared"]:
        alarms = [r for r in own if int(r["wrong"])]
        told = ", ".join(f"{r['effect']} ({100 * float(r['share']):.2g} %)" for r in alarms)
        lines.append(f"undeclared: stretches in {len(alarms)} of {len(own)}: {told or 'none'}")
    return "\n".join(lines)


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    p.add_argument("--events", nargs="+", choices=EVENTS, default=list(EVENTS))
    p.add_argument("--effects", nargs="+", choices=list(EFFECTS), default=list(EFFECTS))
    p.add_argument("--seeds", nargs="+", type=int, default=[2])
    p.add_argument("--undeclared", action="store_true", help="cases of benchmarks/undeclared instead")
    p.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES), metavar="CASE")
    p.add_argument("--again", action="store_true", help="repeat rows that are there")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "undeclared")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "stretches.csv")
    o = p.parse_args()
    rows = {(r["model"], r["event"], r["effect"], int(r["seed"])): r for r in read_rows(o.out)}
    known = {(r["case"], int(r["seed"])): r for r in read_rows(ROOT / "results" / "diagnosis.csv")}
    own = [(m, v, e, s) for s in o.seeds for m in o.models for e in o.effects for v in o.events]
    cases = [(CASES[c].model, "none", c, s) for s in o.seeds for c in o.cases]
    for key in () if o.summary else cases if o.undeclared else own:
        if key in rows and not o.again:
            continue
        if o.undeclared and (key[2], key[3]) not in known:
            continue
        found = known.get((key[2], key[3]), {})
        row = look_at_undeclared(key[2], key[3], o.data, found) if o.undeclared else look(*key)
        rows[key] = r = {k: str(v) for k, v in row.items()}
        print(f"{' '.join(map(str, key)):44s} planted {r['planted']} found {r['found']} wrong {r['wrong']} | "
              f"{r['verdict']} {r['answer']} | with: {r.get('verdict_with', '')} {r.get('answer_with', '')} | "
              f"{r['seconds']} s", flush=True)  # fmt: skip
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

"""Machines that nobody designed: each seed draws another mechanism, and up to four things hidden in it. A row a seed.

    python benchmarks/drawn_machines.py --seeds 0 1 2 3       # finished rows are kept
    python benchmarks/drawn_machines.py --seeds 0 1 2 3 --positions    # without the velocities
    python benchmarks/drawn_machines.py --seeds 0 1 2 3 --crawlers     # trunks with legs on a floor
    python benchmarks/drawn_machines.py --summary

Two to five links on hinges and slides, in a chain or a tree, on the ground or on a cart; motors, position or velocity
servos, or some of each; any integrator and time step. Crawlers are trunks that fall onto a floor, in the plane, and
move there by one to three legs of one or two links. What is hidden is drawn too, the floor's friction and softness
among it, and put into the compiled model, its commands or its readings by no code of the effects. It is drawn again
where the model as it was predicts ten control steps as well as the sensors see. 12 episodes of 100 control steps; noise
of 0.5 mm or mrad, and ten times that of velocities. Writes results/drawn_machines.csv or drawn_crawlers.csv: ``right``
says that all that is hidden is named, each by a cause of its own, first or among what it could also be, and nothing
else is.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from benchmarks.diagnosis import positions_alone
from benchmarks.drawn.crawler import draw_crawler
from benchmarks.drawn.hidden import Hidden, Place
from benchmarks.drawn.machine import Machine, draw_machine, play, random_commands, with_hidden
from benchmarks.suite_models import NOISE_Q, NOISE_V
from benchmarks.tables import read_rows, write_rows

from cli.provenance import git_commit
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "seed", "velocities", "joints", "motors", "integrator", "hidden", "truth", "right", "missed", "extra", "found",
    "covered", "verdict", "before", "after", "seconds", "commit",
)  # fmt: skip
EPISODES, STEPS, AHEAD = 12, 100, 10
SEEN = 3.0
"""Sigmas of a sensor by which the model as it was must err, over ``AHEAD`` control steps, for what is hidden."""
BURSTS = 1e6
"""The same from which on it is the simulation with what is hidden that errs: a drag at too long a time step."""
HOW_MANY = (0, 1, 1, 2, 2, 3, 4)
"""Things hidden in machines, by the seed."""


class SimulationBursts(ValueError):
    """What is hidden makes the simulation unstable."""


def record(machine: Machine, hidden: list[Hidden], rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """States (T+1, nq + nv) and commands (T, nu) of every episode, without noise."""
    model, made = with_hidden(machine.spec, hidden), []
    data = mujoco.MjData(model)
    for k in range(EPISODES):
        mujoco.mj_resetData(model, data)
        machine.begin(model, data, rng)
        commands = random_commands(model, machine.period, STEPS, k, rng)
        made.append((play(model, data, commands, machine.steps, hidden), commands))
    return made


def shown(machine: Machine, hidden: Hidden, rng: np.random.Generator, velocities: bool = True) -> float:
    """By how many sigmas of the sensors the model as it was errs over ten control steps, in its worst channel."""
    model, errors = machine.spec.compile(), []
    data, noise = mujoco.MjData(model), np.repeat([NOISE_Q, NOISE_V], model.nq)
    for x, u in record(machine, [hidden], rng):
        seen = x + np.concatenate([hidden.offset + np.zeros(model.nq), np.zeros(model.nv)])
        for k in range(3 * AHEAD, STEPS - AHEAD, AHEAD):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = np.split(seen[k], 2)
            errors.append((play(model, data, u[k : k + AHEAD], machine.steps, [])[-1] - seen[k + AHEAD]) / noise)
    measured = slice(None) if velocities else slice(model.nq)
    return float(np.sqrt(np.mean(np.square(errors), 0))[measured].max())


def draw(seed: int, velocities: bool = True, crawler: bool = False) -> tuple[mujoco.MjSpec, list[Hidden], Trajectories]:
    """A machine, what is hidden in it, and what its sensors say.

    Raises:
        SimulationBursts: all that is hidden together does that, though no part alone did.
    """
    rng = np.random.default_rng([seed, 20261130])
    machine = draw_crawler(rng) if crawler else draw_machine(rng)
    model, hidden, kinds = machine.spec.compile(), list[Hidden](), list(rng.permutation(machine.kinds))
    while kinds and len(hidden) < HOW_MANY[seed % len(HOW_MANY)]:
        where = rng.integers((1, machine.first_joint, 0), (model.nbody, model.nv, model.nu))
        h = kinds.pop()(Place(model, machine.period, rng, *map(int, where)))
        if h is not None and SEEN < shown(machine, h, rng, velocities) < BURSTS:
            hidden.append(h)
    made, offset = [], sum((h.offset for h in hidden), np.zeros(model.nq))
    for x, u in record(machine, hidden, rng):
        q, v = np.split(x, 2, axis=1)
        seen = {"qpos": q + offset + NOISE_Q * rng.normal(size=q.shape), "qvel": v + NOISE_V * rng.normal(size=v.shape)}
        if not (np.abs(x) < BURSTS * NOISE_V).all():
            raise SimulationBursts(f"seed {seed}")
        made.append(Episode(u, seen))
    data = Trajectories(tuple(made), machine.period)
    return machine.spec, hidden, data if velocities else positions_alone(data)


def matches(truth: list[Hidden], names: list[set[tuple[str, str]]]) -> int:
    """How many hidden things are named, each by another finding."""
    best = 0
    for order in itertools.permutations(range(len(names)), min(len(names), len(truth))):
        for chosen in itertools.combinations(truth, len(order)):
            best = max(best, sum((h.effect, h.target) in names[k] for h, k in zip(chosen, order, strict=True)))
    return best


def run(seed: int, velocities: bool = True, crawler: bool = False) -> dict:
    """Draw, diagnose, compare."""
    spec, hidden, data = draw(seed, velocities, crawler)
    model, started = spec.compile(), time.perf_counter()
    report = diagnose(spec, data, seed=seed).report
    physical = [e for e in report["effects"] if e["effect"] != "numerics"]
    names = [alike(model, e) for e in physical]
    named = matches(hidden, names)
    covered = [int(low <= h.value <= high) for h in hidden for low, high in intervals(h, physical)]
    kinds = sorted({"servo" if b else "motor" for b in model.actuator_biastype})
    return {
        "seed": seed, "velocities": int(velocities), "joints": model.nv, "motors": " ".join(kinds),
        "integrator": mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"), "hidden": len(hidden),
        "truth": " + ".join(f"{h.effect}({h.target}) {h.parameter}={h.value:.4g}" for h in hidden),
        "right": int(named == len(hidden) == len(names)), "missed": len(hidden) - named, "extra": len(names) - named,
        "found": " + ".join(f"{e['effect']}({e['target']})" for e in physical),
        "covered": float(np.mean(covered)) if covered else "", "verdict": report["verdict"],
        **{k: report["error"][k] for k in ("before", "after")}, "seconds": round(time.perf_counter() - started, 1),
        "commit": git_commit(),
    }  # fmt: skip


def alike(model: mujoco.MjModel, entry: dict) -> set[tuple[str, str]]:
    """Effects and targets that a finding stands for.

    Of all motors is of the one where there is one; of the floor is of all that touches, as all touch the floor.
    """
    names = {(q["effect"], q["target"]) for q in (entry, *entry["equivalent"])}
    names |= {(e, "*") for e, t in names if t == "floor"}
    if model.nu > 1:
        return names
    other = {"*": model.actuator(0).name, model.actuator(0).name: "*"}
    return names | {(e, other[t]) for e, t in names if t in other and not e.startswith("joint")}


def intervals(hidden: Hidden, found: list[dict]) -> list[tuple[float, float]]:
    """Of its parameter, where it is found under its own name."""
    own = [e["parameters"] for e in found if (e["effect"], e["target"]) == (hidden.effect, hidden.target)]
    return [tuple(p[hidden.parameter]["ci95"]) for p in own if p.get(hidden.parameter, {}).get("ci95")]


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row for each number of hidden things."""
    lines = ["| hidden | machines | right | named of hidden | extra | median s |", "|---|---|---|---|---|---|"]
    for n in sorted({int(r["hidden"]) for r in rows}):
        of = [r for r in rows if int(r["hidden"]) == n]
        right, missed, extra = (sum(int(r[k]) for r in of) for k in ("right", "missed", "extra"))
        seconds = np.median([float(r["seconds"]) for r in of])
        lines.append(
            f"| {n} | {len(of)} | {right} | {n * len(of) - missed} of {n * len(of)} | {extra} | {seconds:.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the seeds that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--positions", action="store_true", help="leave the measured velocities out")
    p.add_argument("--crawlers", action="store_true", help="trunks with legs on a floor")
    p.add_argument("--summary", action="store_true", help="only print the table of what is there")
    p.add_argument("--out", type=Path, help="instead of the table of results")
    o = p.parse_args()
    out = o.out or ROOT / "results" / f"drawn_{'crawlers' if o.crawlers else 'machines'}.csv"
    rows = {(int(r["seed"]), int(r["velocities"])): r for r in read_rows(out)}
    for key in [] if o.summary else [(seed, int(not o.positions)) for seed in o.seeds]:
        if key not in rows:
            try:
                rows[key] = run(key[0], bool(key[1]), o.crawlers)
            except SimulationBursts as burst:
                print(f"{burst}: no machine, as its simulation bursts", flush=True)
                continue
            write_rows(out, [rows[k] for k in sorted(rows)], FIELDS)
            print({k: rows[key][k] for k in FIELDS[:-1]}, flush=True)
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

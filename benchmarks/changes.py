"""Does `idapt diagnose` see that an effect changes while it is recorded, and keep quiet where it does not?

    python benchmarks/changes.py --seeds 1 2           # finished rows are kept
    python benchmarks/changes.py --summary

A payload that is picked up half way, a motor that fades, a battery that sags, a bearing that wears, and controls with
the same effects constant. Writes results/changes.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
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

from benchmarks.laws.models import LAW_MODELS, register_models
from benchmarks.undeclared import hidden
from benchmarks.undeclared.cases import FINE, Case
from benchmarks.undeclared.generate import generate
from benchmarks.undeclared.hidden import Force, Part, Truth
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "case", "kind", "model", "seed", "verdict", "found", "tested", "says", "first", "last", "at", "episode", "p",
    "right_effect", "right_kind", "false_alarm", "before", "after", "law", "seconds", "cpu_seconds", "commit",
)  # fmt: skip

Change = Callable[[mujoco.MjModel, int, float], None]
"""Edits a model by the number of the episode and the time in it."""


def changing(name: str, target: str, change: Change, model: str) -> Part:
    """Something that is another thing later; ``change`` is called before every physics step."""
    episode = -1

    def start(true: mujoco.MjModel) -> Force:
        nonlocal episode
        episode = (episode + 1) % LAW_MODELS[model].episodes

        def act(true: mujoco.MjModel, data: mujoco.MjData, now: int = episode) -> None:
            change(true, now, data.time)

        return act

    return Part(Truth(name, target, "changes", None), force=start)


def pick_up(true: mujoco.MjModel, episode: int, time: float) -> None:
    """0.3 kg more at the lower link from half way through the fifth episode on."""
    i = true.body("lower").id
    factor = 1.75 if episode > 4 or (episode == 4 and time > 0.8) else 1.0
    true.body_mass[i], true.body_inertia[i] = 0.4 * factor, np.array([0.002, 0.002, 0.0001]) * factor


def fade(true: mujoco.MjModel, episode: int, time: float) -> None:
    """The motor loses half of its torque within every episode."""
    true.actuator_gear[true.actuator("axis").id, 0] = 2.0 * (1 - 0.5 * (1 - np.exp(-time / 0.4)))


def sag(true: mujoco.MjModel, episode: int, time: float) -> None:
    """The battery gives 5 % less from one episode to the next."""
    true.actuator_gear[true.actuator("shoulder").id, 0] = 4.0 * (1 - 0.05 * (episode + time / 2))


def wear(true: mujoco.MjModel, episode: int, time: float) -> None:
    """Damping of the elbow grows from one episode to the next."""
    true.dof_damping[true.joint("elbow").dofadr[0]] = 0.04 + 0.015 * (episode + time / 2)


@dataclass(frozen=True)
class ChangeCase:
    """What changes, and which answers are right; a control has no kinds."""

    model: str
    part: Callable[[], Part]
    accept: frozenset[tuple[str, str]]
    kinds: frozenset[str]


def _case(model: str, part: Callable[[], Part], accept: str = "", kinds: str = "") -> ChangeCase:
    pairs = frozenset(tuple(words.split("@")) for words in accept.split())
    return ChangeCase(model, part, pairs, frozenset(kinds.split()))


CASES = {
    "payload_picked_up": _case(
        "two_link",
        lambda: changing("payload", "lower", pick_up, "two_link"),
        "payload@lower body_mass@lower body_inertia@lower",
        "step_over",
    ),
    "motor_fades": _case(
        "pendulum",
        lambda: changing("actuator_gain", "axis", fade, "pendulum"),
        "actuator_gain@axis",
        "decay_within drift_within",
    ),
    "battery_sags": _case(
        "two_link",
        lambda: changing("actuator_gain", "shoulder", sag, "two_link"),
        "actuator_gain@shoulder",
        "drift_over",
    ),
    "bearing_wears": _case(
        "two_link",
        lambda: changing("joint_damping", "elbow", wear, "two_link"),
        "joint_damping@elbow",
        "drift_over",
    ),
    "constant_damping": _case("pendulum", lambda: hidden.joint_damping("axis", 0.15)),
    "constant_dry_friction": _case("pendulum", lambda: hidden.joint_frictionloss("axis", 0.15)),
    "constant_gain": _case("two_link", lambda: hidden.motor_gain("shoulder", 0.8)),
    "constant_payload": _case("two_link", lambda: hidden.body_mass("lower", 0.6)),
    "constant_weak_motor": _case("pendulum", lambda: hidden.motor_gain("axis", 0.7)),
    "constant_elbow_damping": _case("two_link", lambda: hidden.joint_damping("elbow", 0.1)),
}


def run(name: str, seed: int, data: Path) -> dict:
    """Record, diagnose, score."""
    planted = CASES[name]
    part = planted.part()
    case = Case(name, planted.model, (part.truth,), "outside", (), (part,), FINE, LAW_MODELS[planted.model].noise)
    nominal, measured = generate(case, seed, data / name / f"seed{seed}")
    started, used = time.perf_counter(), time.process_time()
    d = diagnose(mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured), seed=seed, threads=1)
    result, changes = d.result, d.result.changes
    first = changes.found[0] if changes is not None and changes.found else None
    right = bool(first and (first.effect, first.target) in planted.accept)
    return {
        "case": name, "kind": "change" if planted.kinds else "control", "model": planted.model, "seed": seed,
        "verdict": d.verdict.value, "found": " + ".join(f"{e.effect}({e.target})" for e in result.effects),
        "tested": changes.tested if changes is not None else 0,
        "says": f"{first.effect}({first.target}).{first.parameter} {first.kind}" if first else "",
        **{k: getattr(first, k) if first else "" for k in ("first", "last", "at", "episode", "p")},
        "right_effect": int(right) if planted.kinds else "",
        "right_kind": int(right and first.kind in planted.kinds) if planted.kinds and first else 0 * len(planted.kinds),
        "false_alarm": "" if planted.kinds else int(first is not None),
        "before": result.error.before, "after": result.error.after,
        "law": " ; ".join(f.formula for f in result.laws.found) if result.laws is not None else "",
        "seconds": round(time.perf_counter() - started, 1), "cpu_seconds": round(time.process_time() - used, 1),
        "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """The figures that matter."""
    changes = [r for r in rows if r["kind"] == "change"]
    controls = [r for r in rows if r["kind"] == "control" and int(r["tested"])]
    count = lambda name, chosen: f"{sum(int(r[name]) for r in chosen)} of {len(chosen)}"  # noqa: E731
    return (
        f"right effect    {count('right_effect', changes)}\nand right kind  {count('right_kind', changes)}\n"
        f"false alarms    {count('false_alarm', controls)} controls "
        f"({sum(int(r['tested']) for r in controls)} parameters)"
    )


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", nargs="+", choices=sorted(CASES), default=list(CASES), metavar="CASE")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--again", action="store_true", help="repeat rows that are there")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--data", type=Path, default=ROOT / "runs" / "changes")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "changes.csv")
    o = p.parse_args()
    register_models()
    rows = read_rows(o.out)
    wanted = [(n, s) for s in o.seeds for n in o.cases] if not o.summary else []
    for name, seed in tqdm(wanted, unit="case", disable=not sys.stderr.isatty()):
        same = [r for r in rows if (r["case"], int(r["seed"])) == (name, seed)]
        if same and not o.again:
            continue
        rows = [r for r in rows if r not in same] + [{k: str(v) for k, v in run(name, seed, o.data).items()}]
        order = list(CASES)
        write_rows(o.out, sorted(rows, key=lambda r: (order.index(r["case"]), int(r["seed"]))), FIELDS)
        print(f"{name:24s} {seed} {rows[-1]['says'] or '-'} | {rows[-1]['found']}", flush=True)
    for words, late in (("seed 0, in sight while tuning", False), ("other seeds", True)):
        if chosen := [r for r in rows if (int(r["seed"]) > 0) == late]:
            print(f"--- {words}\n{summarise(chosen)}")


if __name__ == "__main__":
    main()

"""How many further recordings until a diagnosis names one effect: `idapt excite` against random motions and a chirp.

    python benchmarks/excitation.py --seeds 0 1 2     # all cases; finished rows are kept
    python benchmarks/excitation.py --cases pendulum_friction --seeds 0
    python benchmarks/excitation.py --summary         # the figures of what is there

A first recording that shows too little is diagnosed. Then, up to three times (``--most``), a motion is found, the
hidden truth plays it twice (noise included), the two episodes join the recordings, one to fit and one to judge on, and
all are diagnosed again. Motions of all methods have the same length and keep the same limits; those of the others are
as large as these allow, and use the same explanations to be safe.

Outcomes: ``named``, one effect, with nothing beside it but what no motion can tell from it; ``inseparable``, `idapt
excite` says that no safe motion tells the truth and what else it could be apart; ``wrong``, something else is named
alone; ``open``, none of these. Writes results/excitation.csv; its cases are in benchmarks/excitation_cases.py.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from tables import read_rows, write_rows

from benchmarks.excitation_cases import CONFOUNDED, IN_SIGHT, Confounded
from benchmarks.undeclared.generate import Recording, control_period, first_episodes, replay
from benchmarks.undeclared.models import nominal_xml
from cli.provenance import git_commit
from datamodules import Episode, Trajectories
from idapt_pl.diagnosis.answer.explanation import Explanation, Measurement
from idapt_pl.diagnosis.answer.result import DiagnosisResult
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.settings import SearchSettings
from idapt_pl.excitation.design import SEPARATED, MotionSearch
from idapt_pl.excitation.limits import ImpossibleMotion, limits_of
from idapt_pl.excitation.motion import FourierMotion
from idapt_pl.excitation.plan import MotionPlan, prepare_search
from idapt_pl.excitation.rivals import LeftOpen, rival_of

FIELDS = (
    "case", "model", "seed", "duration", "most", "method", "outcome", "recordings", "first_found", "first_class",
    "found", "class", "separation", "cpu_seconds", "commit",
)  # fmt: skip
METHODS = ("excite", "random", "chirp")
SECONDS = 8.0
CANDIDATES = (
    "joint_damping", "joint_frictionloss", "joint_stribeck", "joint_armature", "joint_stiffness", "actuator_gain",
    "actuator_bias", "actuator_deadzone", "actuator_delay", "actuator_lag", "body_mass", "body_com", "payload",
    "sensor_gain", "sensor_bias", "gravity_direction", "fluid_drag",
)  # fmt: skip
"""What is considered, and the kind that is hidden: no shape of bodies and nothing that touches, to save time."""
OWN = {"servo_arm": {"actuator_kp", "actuator_kv"}}
"""And for servos."""
NOTHING_FOR = {"pusher": {"gravity_direction"}, "dc_arm": {"actuator_gain"}}
"""No weight acts on the first; the second has another effect for what its motors exert."""
SETTINGS = SearchSettings(max_effects=2, numerics=False)
"""The true time step is the model's: it is not searched."""


@dataclass(frozen=True)
class Named:
    """What a diagnosis names: each effect with all that is equivalent to it."""

    classes: tuple[frozenset[tuple[str, str]], ...]
    result: DiagnosisResult

    @classmethod
    def of(cls, result: DiagnosisResult) -> Named:
        """From a result, without numerics."""
        physical = [e for e in result.effects if e.effect != "numerics"]
        return cls(tuple(frozenset({e.key, *((a.effect, a.target) for a in e.equivalent)}) for e in physical), result)

    def done(self, case: Confounded) -> bool:
        """Whether it is the truth, or what no motion can tell from it."""
        return len(self.classes) == 1 and self.classes[0] <= case.answers

    def holds(self, case: Confounded) -> bool:
        """Whether one thing is named, and the truth is among what it could be."""
        return len(self.classes) == 1 and bool(self.classes[0] & case.answers)

    def settled(self) -> bool:
        """Whether a user would stop here: effects are named, and each stands alone."""
        return bool(self.classes) and all(len(c) == 1 for c in self.classes)

    def label(self) -> str:
        """Effects found."""
        return " + ".join(f"{e.effect}({e.target})" for e in self.result.effects)

    def members(self) -> str:
        """All members of the classes."""
        return " | ".join(" ".join(f"{e}({t})" for e, t in sorted(c)) for c in self.classes)


def trajectories(case: Confounded, recordings: list[Recording]) -> Trajectories:
    """Recordings as a diagnosis takes them."""
    nq = mujoco.MjModel.from_xml_string(nominal_xml(case.model)).nq
    episodes = (Episode(r.actions, {"qpos": r.measured[:, :nq], "qvel": r.measured[:, nq:]}) for r in recordings)
    return Trajectories(tuple(episodes), control_period(case.model), f"a recording of {case.model}")


def diagnosed(case: Confounded, first: list[Recording], new: list[Recording], seed: int) -> Named:
    """Diagnose; of the first recordings the second is held out, of each new pair the second."""
    hold_out = [1, *range(len(first) + 1, len(first) + len(new), 2)]
    spec, data = mujoco.MjSpec.from_string(nominal_xml(case.model)), trajectories(case, [*first, *new])
    hidden = {t.effect for t in case.world.truth}
    names = {*CANDIDATES, *hidden, *OWN.get(case.model, ())} - NOTHING_FOR.get(case.model, set())
    found = diagnose(spec, data, hold_out=hold_out, candidates=sorted(names), seed=seed, settings=SETTINGS, threads=1)
    return Named.of(found.result)


def left_open(case: Confounded, named: Named) -> LeftOpen:
    """What a diagnosis left open, as from its report."""
    report = json.loads(json.dumps(named.result.to_dict()))
    rivals = tuple(rival_of((), Explanation.from_dict(e)) for e in report["explanations"])
    spec = mujoco.MjSpec.from_string(nominal_xml(case.model))
    return LeftOpen(spec, rivals, Measurement.from_dict(report["measurement"]), {})


@dataclass(frozen=True)
class ChirpMotion(FourierMotion):
    """All actuators sweep from one period a motion to the fastest frequency; coefficients are their amplitudes."""

    def unbounded(self, x: np.ndarray) -> np.ndarray:
        """What coefficients (n, nu) add to the commands, (n, T, nu)."""
        steps, nu = self.around.shape
        t = np.arange(steps) / steps
        last = float(self.harmonics.max())
        sweep = np.sin(2 * np.pi * (t + (last - 1) * t**2 / 2))
        half = (self.command[:, 1] - self.command[:, 0]) / 2
        return x.reshape(len(x), 1, nu) * half * sweep[:, None]


def plain_motion(search: MotionSearch, method: str, rng: np.random.Generator) -> np.ndarray:
    """A random motion or a chirp, as large as the limits allow, (T, nu)."""
    if method == "chirp":
        m = search.motion
        search.motion = ChirpMotion(m.around, m.command, m.control_period, m.harmonics)
        x = np.ones((1, m.around.shape[1]))
    else:
        x = search.motion.random(rng, 1)
    x = search.enlarged(x)
    return search.made_safe(x[0])[0][0]


@dataclass(frozen=True)
class Motion:
    """The next recording: commands (T, nu), how far they drive every pair of explanations apart, and whether it is said
    that no safe motion tells what was found from any other.
    """

    commands: np.ndarray
    separations: np.ndarray
    hopeless: bool = False


def next_motion(case: Confounded, named: Named, method: str, seed: int, count: int, duration: float) -> Motion:
    """The motion of a method; ``excite`` alone says that none helps.

    Raises:
        ImpossibleMotion: no motion is safe.
    """
    open_ones = left_open(case, named)
    model = open_ones.spec.copy().compile()
    limits = limits_of(model, {"*": case.position}, {"*": (0.0, case.velocity)})
    plan = MotionPlan(limits, duration=duration, seconds=SECONDS, seed=1000 * seed + count, rivals=4)
    search, evaluations, rivals = prepare_search(open_ones, plan, threads=1)
    if method == "excite":
        design = search.run(evaluations)
        return Motion(
            design.commands, design.separations, bool((design.reachable[: len(rivals) - 1] < SEPARATED).all())
        )
    commands = plain_motion(search, method, np.random.default_rng([seed, count]))
    return Motion(commands, search.criterion.after_refit(commands))


def closed_loop(
    case: Confounded, seed: int, method: str, first: list[Recording], named: Named, duration: float, most: int
) -> dict:
    """Record and diagnose until one effect is named, or none of what is left can be told apart."""
    started, rng = time.process_time(), np.random.default_rng([seed, 17])
    new: list[Recording] = []
    outcome, separations = "open", list[str]()
    while outcome == "open" and len(new) < 2 * most:
        try:
            motion = next_motion(case, named, method, seed, 1 + len(new) // 2, duration)
        except ImpossibleMotion as error:
            print("   ", method, error, flush=True)
            break
        separations.append(" ".join(f"{d:.3g}" for d in motion.separations))
        if motion.hopeless:
            outcome = "inseparable" if named.holds(case) else "wrong"
            break
        new += [replay(case.world, motion.commands, rng, np.array(case.start)) for _ in range(2)]
        named = diagnosed(case, first, new, seed)
        if named.done(case):
            outcome = "named"
        elif named.settled() or not named.classes:
            outcome = "wrong"
    return {
        "outcome": outcome, "recordings": len(new) // 2, "found": named.label(), "class": named.members(),
        "separation": separations[0] if separations else "", "cpu_seconds": round(time.process_time() - started, 1),
    }  # fmt: skip


def rows_of(case: Confounded, seed: int, methods: list[str], duration: float, most: int) -> list[dict]:
    """All methods from the same first recording; one row alone where that was no problem."""
    first = first_episodes(replace(case.world, amplitude=case.amplitude, still=True), case.kinds, seed)
    named = diagnosed(case, first, [], seed)
    same = {
        "case": case.name, "model": case.model, "seed": seed, "duration": duration, "most": most,
        "first_found": named.label(), "first_class": named.members(), "commit": git_commit(),
    }  # fmt: skip
    if named.done(case) or named.settled() or not named.classes:  # nobody would record anything to tell apart
        outcome = "named" if named.done(case) else "wrong" if named.classes else "nothing"
        return [same | {"method": "none", "outcome": outcome, "recordings": 0}]
    return [same | {"method": m} | closed_loop(case, seed, m, first, named, duration, most) for m in methods]


def place(row: dict) -> tuple:
    """Where a row stands in the table."""
    return row["model"], row["case"], int(row["seed"]), float(row["duration"])


def summarise(rows: list[dict], title: str) -> str:
    """How often, and after how many recordings, each method came to one effect."""
    at_once, confounded = ([r for r in rows if (r["method"] == "none") is alone] for alone in (True, False))
    lines = [f"--- {title}; first recordings: {tally(at_once)}; confounded {len({place(r) for r in confounded})}"]
    for method in METHODS:
        mine = [r for r in confounded if r["method"] == method]
        needed = np.array([int(r["recordings"]) for r in mine if r["outcome"] == "named"])
        within = ", ".join(f"within {k}: {(needed <= k).sum()}" for k in (1, 2, 3))
        lines.append(f"{method:8s} {tally(mine)}; named {within}")
    return "\n".join(lines)


def tally(rows: list[dict]) -> str:
    """How many rows have each outcome."""
    return ", ".join(f"{name} {n}" for name, n in sorted(Counter(r["outcome"] for r in rows).items())) or "none"


def main() -> None:
    """Run the missing rows and print the summary."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--cases", nargs="+", choices=sorted(CONFOUNDED), default=list(CONFOUNDED), metavar="CASE")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    p.add_argument("--duration", type=float, default=4.0, help="of a recording, s (default 4)")
    p.add_argument("--most", type=int, default=3, help="further recordings at most (default 3)")
    p.add_argument("--summary", action="store_true", help="only print what is there")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "excitation.csv")
    o = p.parse_args()
    for seed in o.seeds if not o.summary else []:
        for name in o.cases:
            key = (name, seed, o.duration)
            if any((r["case"], int(r["seed"]), float(r["duration"])) == key for r in read_rows(o.out)):
                continue
            made = rows_of(CONFOUNDED[name], seed, o.methods, o.duration, o.most)
            rows = [*read_rows(o.out), *made]
            write_rows(o.out, sorted(rows, key=place), FIELDS)
            for r in made:
                print({k: r.get(k, "") for k in FIELDS if k not in ("commit", "model")}, flush=True)
    rows = read_rows(o.out)
    seen = [r for r in rows if int(r["seed"]) in IN_SIGHT]
    held_back = [r for r in rows if r not in seen]
    for title, chosen in (("seeds that it was developed on", seen), ("held back", held_back)):
        if chosen:
            print(summarise(chosen, title))


if __name__ == "__main__":
    main()

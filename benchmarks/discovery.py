"""Are hidden effects named from images alone, and nothing where nothing is hidden? One row a case and seed.

    python benchmarks/quick.py --seeds 0 1 2 3 4   # makes the runs whose G and estimator are the sensor
    python benchmarks/discovery.py --seeds 0 1 2 3 4

Targets look like the pendulum's hard domain and move like its source but for what is hidden. The sensor, the policy's
encoder, is that of a finished run (trained against the hard domain itself: pole 200 kg), so cases other than the pole's
mass use it on motions that it was not trained on. Writes results/discovery.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

from tables import read_rows, write_rows

from cli.run_folder import load_estimator, load_visual, open_run
from datamodules import write_trajectories
from idapt_pl.discovery import Discovery, discover
from idapt_pl.domains import Domain
from idapt_pl.domains.effects import ActuatorGain, BodyMass, Effect, JointDamping
from idapt_pl.domains.paths import ActuatorDelay
from idapt_pl.envs import VectorImageEnv
from idapt_pl.rollout import EXPLORATION, collect
from idapt_pl.sensing import Sensor
from idapt_pl.worlds import Worlds

OWN_MASS = 4.895
CASES: dict[str, tuple[Effect, ...]] = {
    "nothing": (),
    "pole 200 kg": (BodyMass("pole", 200.0),),
    "pole 50 kg": (BodyMass("pole", 50.0),),
    "hinge damping": (JointDamping("hinge", 4.0),),
    "actuator gain": (ActuatorGain("slide", 0.6),),
    "action delay": (ActuatorDelay("slide", 0.04),),
}
FIELDS = (
    "case", "seed", "found", "disbelieved", "right", "estimate", "low", "high", "truth", "covered",
    "before", "after", "excess", "explained", "target_interactions", "seconds",
)  # fmt: skip


def run(name: str, seed: int, steps: int, folder: Path) -> dict:
    """Record a target with something hidden, look for it."""
    grounding = open_run(folder)
    worlds, G = grounding.worlds, load_visual(grounding)
    sensor = Sensor(load_estimator(grounding), worlds.task, worlds.frame_stack)
    hidden, source, hard = CASES[name], worlds.task.domain("source"), worlds.task.domain("hard")
    target = Domain("hidden", hard.base, (*hard.effects, BodyMass("pole", OWN_MASS), *hidden))
    path, control = (folder / "hidden" / f"{n.replace(' ', '_')}.h5" for n in (name, "control"))
    record(worlds, target, path, steps, seed + 100)
    if not control.exists():
        record(worlds, source, control, steps, seed + 200)
    started = time.perf_counter()
    result = discover(worlds.task, source, sensor, G, [path], [control], Discovery(True), seed)
    return {"case": name, "seed": seed, "target_interactions": steps, **score(result, hidden),
            "seconds": round(time.perf_counter() - started, 1)}  # fmt: skip


def record(worlds: Worlds, domain: Domain, path: Path, steps: int, seed: int) -> None:
    """Images, states and actions of random motions."""
    with closing(VectorImageEnv(worlds.task, domain, 1, worlds.image_size, worlds.frame_stack, worlds.view)) as env:
        write_trajectories(path, collect(env, EXPLORATION["babble"](env, seed), steps, seed, path.stem))


def score(result: dict, hidden: tuple[Effect, ...]) -> dict:
    """Compare what was found with what was hidden."""
    labels = [[f"{e['effect']}({e['target']})" for e in result[k]] for k in ("effects", "disbelieved")]
    row = {"found": " + ".join(labels[0]), "disbelieved": " + ".join(labels[1])}
    row |= {k: round(result[k], 3) for k in ("before", "after", "excess", "explained")}
    if not hidden:
        return row | {"right": int(not labels[0])}
    truth = hidden[0]
    parameter, value = next((k, v) for k, v in truth.to_dict()["parameters"].items())
    row |= {"truth": value, "right": 0}
    for e in result["estimates"][:1]:
        alternatives = [e, *e["equivalent"]]
        row["right"] = int(any((a["effect"], a["target"]) == (truth.name, truth.target) for a in alternatives))
        if p := e["parameters"].get(parameter) if (e["effect"], e["target"]) == (truth.name, truth.target) else None:
            low, high = p["ci95"]
            row |= {"estimate": p["estimate"], "low": low, "high": high, "covered": int(low <= value <= high)}
    return row


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    p.add_argument("--steps", type=int, default=5000, help="control steps taken in the target")
    p.add_argument("--runs", type=Path, default=ROOT / "runs", help="where benchmarks/quick.py left its runs")
    p.add_argument("--out", type=Path, default=ROOT / "results/discovery.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    for seed in o.seeds:
        for name in o.cases:
            if any(r["case"] == name and int(r["seed"]) == seed for r in rows):
                continue
            rows.append(run(name, seed, o.steps, o.runs / f"benchmark_pendulum_quick_IDAPT_{seed}"))
            print({k: v for k, v in rows[-1].items() if v != ""}, flush=True)
            write_rows(o.out, rows, FIELDS)


if __name__ == "__main__":
    main()

"""How much does a diagnosis simulate? One row a case and version: simulations, time steps, processor time.

    python benchmarks/search_cost.py --models dc_arm servo_arm --counts 3 --seeds 61
    python benchmarks/search_cost.py --rigs FOLDER so101       # real machines, as benchmarks/hardware.py
    python benchmarks/tables.py cost                              # one row a case: earliest version and latest

Cases as in benchmarks/gates.py. Rows of earlier versions stay: run this file from a checkout of one to add them
(``--out``). ``steps_m`` are millions of time steps of single windows, the same on every machine; ``cpu_s`` is the
processor time of one thread. ``exact`` says that what is hidden is named and nothing else.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import numpy as np
from benchmarks.gates import recorded
from benchmarks.hardware import RIGS, held_out
from benchmarks.reliability import MODELS
from benchmarks.several_effects import matched, truth_of
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.prediction.model import read_model
from idapt_pl.prediction.simulator import Simulator

FIELDS = (
    "model", "hidden", "seed", "truth", "found", "exact", "loss", "simulations", "steps_m", "cpu_s", "commit",
)  # fmt: skip
CASE = ("model", "hidden", "seed", "commit")


@contextmanager
def counted() -> Iterator[list[int]]:
    """Time steps of single windows that are simulated meanwhile, one number a simulation."""
    counts: list[int] = []
    plain = Simulator.states

    def states(self: Simulator, effects, windows, *moved) -> tuple[np.ndarray, np.ndarray]:
        out = plain(self, effects, windows, *moved)
        counts.append(out[1].shape[0] * out[1].shape[1])
        return out

    Simulator.states = states  # type: ignore[method-assign]
    try:
        yield counts
    finally:
        Simulator.states = plain  # type: ignore[method-assign]


def measured(spec, data, **options) -> dict:
    """Diagnose on one thread; what it took, and what it came to."""
    started = time.process_time()
    with counted() as counts:
        report = diagnose(spec, data, threads=1, **options).report
    return {
        "found": " + ".join(f"{e['effect']}({e['target']})" for e in report["effects"]),
        "loss": report["error"]["after"],
        "simulations": len(counts),
        "steps_m": round(sum(counts) / 1e6, 2),
        "cpu_s": round(time.process_time() - started, 1),
        "effects": [e for e in report["effects"] if e["effect"] != "numerics"],
    }


def of_case(model: str, count: int, seed: int) -> dict:
    """A case with ``count`` hidden effects."""
    drawn, spec, data, _ = recorded(model, count, seed)
    row = measured(spec, data, seed=seed)
    missed, extra = matched(drawn.answers, row["effects"])
    return {"model": model, "hidden": count, "seed": seed, "truth": truth_of(drawn), **row,
            "exact": int(not missed and not extra)}  # fmt: skip


def of_rig(folder: Path, name: str) -> dict:
    """A real machine."""
    rig = RIGS[name]
    data = folder / rig.folder / rig.data
    options = {"hold_out": held_out(data, rig.held_out), "laws": False}
    return {"model": name, **measured(read_model(folder / rig.folder / rig.model), read_trajectories(data), **options)}


def main() -> None:
    """Run the cases that this version has no row of, and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="*", default=[], choices=MODELS)
    p.add_argument("--counts", nargs="+", type=int, default=[3], help="how many effects are hidden")
    p.add_argument("--seeds", nargs="+", type=int, default=[61])
    p.add_argument("--rigs", nargs="+", default=[], metavar="", help="the recordings' folder, then names of rigs")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "search_cost.csv")
    args = p.parse_args()
    rows, commit = read_rows(args.out), git_commit()
    cases = [(of_case, case) for case in itertools.product(args.models, args.counts, args.seeds)]
    cases += [(of_rig, (Path(args.rigs[0]), name)) for name in args.rigs[1:]]
    there = {tuple(r[k] for k in CASE) for r in rows}
    for run, case in tqdm(cases, desc="search cost"):
        key = (*map(str, case), commit) if run is of_case else (case[1], "", "", commit)
        if key in there:
            continue
        rows = [*rows, {"hidden": "", "seed": "", **run(*case), "commit": commit}]
        write_rows(args.out, [{k: r.get(k, "") for k in FIELDS} for r in rows], FIELDS)


if __name__ == "__main__":
    main()

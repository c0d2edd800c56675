"""Is an effect that is chosen whatever is held out more often right? One row for each effect that a search chose.

    python benchmarks/splits.py --seeds 200 201 202        # 2 and 3 hidden effects; finished cases are kept
    python benchmarks/splits.py --summary                  # the table of what is there

Hidden effects are drawn as in benchmarks/several_effects.py. Every case is searched again with each other quarter of
its episodes held out (`idapt diagnose --splits`). Writes results/splits.csv: whether the diagnosis itself ``found`` an
effect, whether it is ``right`` (hidden there, or an accepted name of what is), and in how many of the ``searches`` it
was chosen.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.several_effects import draw
from benchmarks.undeclared.generate import generate
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.splits import with_splits

FIELDS = (
    "model", "hidden", "seed", "effect", "target", "found", "right", "times", "searches", "seconds", "commit",
)  # fmt: skip
MODELS = ("inverted_pendulum", "reacher", "servo_arm")


def run(model: str, hidden: int, seed: int, threads: int | None) -> list[dict]:
    """Record, diagnose, search again, compare."""
    drawn = draw(model, hidden, seed)
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(drawn.case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    started = time.perf_counter()
    splits = with_splits(diagnose(spec, data, seed=seed, threads=threads, laws=False)).result.splits
    assert splits is not None
    right = set().union(*(names for answer in drawn.answers for names in answer))
    every = {
        "model": model, "hidden": hidden, "seed": seed, "searches": len(splits.searches),
        "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip
    return [
        every
        | {
            "effect": t.key[0], "target": t.key[1], "found": int(t.key in splits.searches[0].effects),
            "right": int(t.key in right), "times": t.times,
        }
        for t in splits.times_chosen()
        if t.key[0] != "numerics"
    ]  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """A Markdown table: of effects that were found, and of others, how many are right by how often they are chosen."""
    lines = ["| chosen | found by the diagnosis | of these right | by other searches alone | of these right |"]
    lines.append("|" + "---|" * 5)
    for times in range(4, 0, -1):
        of = [[r for r in rows if int(r["times"]) == times and int(r["found"]) == found] for found in (1, 0)]
        cells = [f"{len(each)} | {sum(int(r['right']) for r in each)}" for each in of]
        lines.append(f"| {times} of 4 | {cells[0]} | {cells[1]} |")
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no rows yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=MODELS)
    p.add_argument("--counts", nargs="+", type=int, default=[2, 3], help="how many effects are hidden")
    p.add_argument("--seeds", nargs="+", type=int, default=[200])
    p.add_argument("--threads", type=int)
    p.add_argument("--summary", action="store_true", help="print the table of what is there, and run nothing")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "splits.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    done = {(r["model"], int(r["hidden"]), int(r["seed"])) for r in rows}
    todo = [] if o.summary else [k for k in itertools.product(o.models, o.counts, o.seeds) if k not in done]
    for key in tqdm(todo, unit="case"):
        rows = [*rows, *run(*key, threads=o.threads)]
        write_rows(o.out, rows, FIELDS)
    print(summarise(rows))


if __name__ == "__main__":
    main()

"""Where does the time of two runs of one config go, an earlier version's and a later one's? By stage, in seconds.

    python benchmarks/run_times.py --before runs/pendulum_before --after runs/pendulum_after --note "two free cores"

``whole`` is the time in which at least one stage was at work: stages that run side by side count once. Writes
results/run_times.csv, a row a stage; rows of the same task, seed and note are replaced.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tables import replace_rows

KEY = ("task", "seed", "note", "step", "stage")


def seconds(run: Path) -> tuple[dict, dict[tuple[int, str], float]]:
    """A run's summary, and what every stage of it took."""
    summary = json.loads((run / "summary.json").read_text())
    return summary, {(s["step"], s["stage"]): s["wall_s"] for s in summary["stages"]}


def rows(before: Path, after: Path, note: str) -> list[dict]:
    """A row for each stage that took a second, and one for the whole."""
    (old, then), (new, now) = seconds(before), seconds(after)
    commits = [json.loads((run / "run.json").read_text())["git_commit"][:10] for run in (before, after)]
    cpu = json.loads((after / "run.json").read_text())["cpu"]
    about = {"task": new["task"], "seed": new["seed"], "note": note}
    stages = [k for k in dict.fromkeys([*then, *now]) if max(then.get(k, 0), now.get(k, 0)) >= 1]
    lines = [(*k, then.get(k, ""), now.get(k, "")) for k in stages] + [("", "whole", old["wall_s"], new["wall_s"])]
    return [
        about | {"step": step, "stage": stage, "before_s": a, "after_s": b, "commit_before": commits[0],
                 "commit_after": commits[1], "cpu": cpu}
        for step, stage, a, b in lines
    ]  # fmt: skip


def main() -> None:
    """Compare two runs."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--before", type=Path, required=True, help="run folder of the earlier version")
    p.add_argument("--after", type=Path, required=True, help="run folder of the later one")
    p.add_argument("--note", default="", help="what else the machine did")
    o = p.parse_args()
    found = rows(o.before, o.after, o.note)
    print(*found, sep="\n")
    replace_rows(ROOT / "results/run_times.csv", found, KEY)


if __name__ == "__main__":
    main()

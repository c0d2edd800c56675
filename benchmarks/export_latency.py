"""How long does an exported policy take for an action? On one core of a CPU, one image at a time.

    python benchmarks/export_latency.py RUN [RUN ...]

Exports the last policy of each run folder as ``idapt export`` does, which checks it, into a folder that is thrown away,
and calls it. ``ms`` is the least of several medians of 200 calls, as other work on the machine only adds to it; ``mb``
is the file's size. Writes results/export_latency.csv, a row a run.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tables import RESULTS, replace_rows

from cli import export
from cli.provenance import cpu_model, git_commit
from idapt_pl.run import Run
from idapt_pl.targets import target_name

ROUNDS = 5
KEY = ("task", "target", "seed", "cpu")


def row(folder: Path) -> dict[str, object]:
    """Latency of a run's last policy."""
    run = Run.open(folder)
    config = run.config
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "policy.onnx"
        export.main(["--run", str(folder), "--out", str(path)])
        stacks, _ = export.recorded_stacks(run, export.chosen_checkpoint(run, None))
        seconds = min(export.latency(path, stacks[:1]) for _ in range(ROUNDS))
        size = path.stat().st_size
    return {
        "task": config.task,
        "target": target_name(config.target),
        "seed": config.seed,
        "image_size": config.image_size,
        "frame_stack": config.frame_stack,
        "memory": config.modules["policy"]["memory"],
        "mb": round(size / 1e6, 2),
        "ms": round(1000 * seconds, 3),
        "cpu": cpu_model(),
        "commit": git_commit(),
    }


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("runs", type=Path, nargs="+", help="run folders, finished")
    p.add_argument("--out", type=Path, default=RESULTS / "export_latency.csv")
    o = p.parse_args()
    for folder in o.runs:
        replace_rows(o.out, [row(folder)], KEY)
    print(o.out.read_text())


if __name__ == "__main__":
    main()

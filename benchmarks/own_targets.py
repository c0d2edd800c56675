"""Targets that nobody here wrote: another physics engine, and another model of the same thing (``examples/``).

    python benchmarks/own_targets.py --example cartpole_dm_control cartpole_pybullet --seeds 0 1 2

Runs ``idapt fit`` in ``examples/`` for every seed (finished runs are not repeated) and writes results/own_targets.csv,
as ``benchmarks/quick.py`` does. ``cartpole_pybullet`` needs ``pip install pybullet``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import quick
from tables import replace_rows

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--example", nargs="+", default=["cartpole_dm_control", "cartpole_pybullet", "pendulum_gymnasium"])
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    p.add_argument("--out", type=Path, default=ROOT / "results/own_targets.csv")
    o, extra = p.parse_known_args()
    for name in o.example:
        for seed in o.seeds:
            folder = ROOT / f"runs/example_{name}_{seed}"
            command = [sys.executable, "-c", "import sys; from cli.main import main; sys.exit(main())", "fit"]
            command += ["--config", f"{name}.yaml", "--seed", str(seed), "--run_dir", str(folder), *extra]
            if not (folder / "summary.json").exists():
                subprocess.run(command, cwd=ROOT / "examples", check=True)
            replace_rows(o.out, quick.rows(folder, "IDAPT"), ("task", "target", "seed"), quick.FIELDS)
    print(o.out.read_text())


if __name__ == "__main__":
    main()

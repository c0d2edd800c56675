"""Does IDAPT carry the pendulum from source to hard within the budget of a laptop? Seeds, one row each.

    python benchmarks/pendulum.py --seeds 0 1 2 3 4

Runs ``idapt fit`` with configs/pendulum_quick.yaml for every seed (finished runs are not repeated) and
writes results/pendulum_quick.csv: one row a policy, so that direct transfer, visual grounding alone and
every grounding step stand side by side. Failures stay in the table.
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FIELDS = (
    "task",
    "target",
    "method",
    "seed",
    "grounding_step",
    "return",
    "target_interactions",
    "minutes",
    "commit",
    "cpu",
)


def run(config: Path, seed: int, extra: list[str], name: str) -> tuple[dict, dict]:
    """One run, resumed or loaded if it was made before. Returns its summary and provenance."""
    folder = ROOT / "runs" / f"{name}_{seed}"
    command = [
        sys.executable,
        "-m",
        "cli",
        "fit",
        "--config",
        str(config),
        "--seed",
        str(seed),
        "--run_dir",
        str(folder),
    ]
    if not (folder / "summary.json").exists():
        subprocess.run([*command, *extra], cwd=ROOT, check=True)
    return tuple(json.loads((folder / f"{f}.json").read_text()) for f in ("summary", "run"))


def rows(summary: dict, provenance: dict, method: str) -> list[dict]:
    """Rows of the results table."""
    common = {
        "task": summary["task"],
        "target": summary["target"],
        "seed": summary["seed"],
        "commit": provenance["git_commit"],
        "cpu": provenance["cpu"],
        "target_interactions": summary["target_interactions"],
        "minutes": round(summary["wall_s"] / 60, 1),
    }
    found = [("direct transfer", "", summary["direct_transfer"]), ("visual only", 0, summary["visual_only"])]
    found += [(method, k, value) for k, value in enumerate(summary["grounded"], 1)]
    if summary["oracle"] is not None:
        found.append(("oracle", "", summary["oracle"]))
    return [common | {"method": m, "grounding_step": k, "return": round(v, 1)} for m, k, v in found]


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--config", type=Path, default=ROOT / "configs/pendulum_quick.yaml")
    p.add_argument("--method", default="IDAPT", help="name in the table, for ablations")
    p.add_argument("--out", type=Path, default=ROOT / "results/pendulum_quick.csv")
    o, extra = p.parse_known_args()
    name = f"benchmark_{o.config.stem}_{o.method.replace(' ', '_')}"
    table = [row for seed in o.seeds for row in rows(*run(o.config, seed, extra, name), o.method)]
    with o.out.open("w", newline="") as f:
        writer = csv.DictWriter(f, FIELDS)
        writer.writeheader()
        writer.writerows(table)
    print(o.out.read_text(), f"({platform.machine()})")


if __name__ == "__main__":
    main()

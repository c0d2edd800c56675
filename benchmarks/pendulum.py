"""Does IDAPT carry the pendulum from source to hard within the budget of a laptop? Seeds, one row each.

    python benchmarks/pendulum.py --seeds 0 1 2 3 4

Runs ``idapt fit`` with configs/pendulum_quick.yaml for every seed (finished runs are not repeated) and
writes results/pendulum_quick.csv: one row a policy, so that direct transfer, visual grounding alone and
every grounding step stand side by side. Failures stay in the table. An ablation gets rows of its own:

    python benchmarks/pendulum.py --seeds 3 --method "no resets" --visual.reset_weight 0
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
    "run",
    "method",
    "seed",
    "grounding_step",
    "return",
    "std",
    "psnr",
    "target_interactions",
    "minutes",
    "commit",
    "cpu",
)


def run(config: Path, seed: int, extra: list[str], name: str) -> Path:
    """One run, resumed, or left as it is if it was finished before. Returns its folder."""
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
    return folder


def rows(folder: Path, method: str) -> list[dict]:
    """Rows of the results table: returns over the episodes, G's error against paired target images (dB)."""

    def read(name: str) -> dict:
        return json.loads((folder / f"{name}.json").read_text())

    summary, provenance = read("summary"), read("run")
    common = {
        "task": summary["task"],
        "target": summary["target"],
        "run": method,
        "seed": summary["seed"],
        "commit": provenance["git_commit"],
        "cpu": provenance["cpu"],
        "target_interactions": summary["target_interactions"],
        "minutes": round(summary["wall_s"] / 60, 1),
    }
    found = [("direct transfer", "", read("step_00/direct_transfer"), "")]
    for k in range(len(summary["grounded"]) + 1):
        measured = read(f"step_{k:02d}/evaluation")
        name = method if k else "visual only"
        found.append((name, k, measured["target"], measured["translation"]["psnr"]))
    if summary["oracle"] is not None:
        found.append(("oracle", "", read("step_00/oracle_evaluation"), ""))
    return [
        {**common, "method": name, "grounding_step": k, "return": round(r["mean"], 1), "std": round(r["std"], 1),
         "psnr": psnr}
        for name, k, r, psnr in found
    ]  # fmt: skip


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--config", type=Path, default=ROOT / "configs/pendulum_quick.yaml")
    p.add_argument("--method", default="IDAPT", help="name in the table, for ablations")
    p.add_argument("--out", type=Path, default=ROOT / "results/pendulum_quick.csv")
    o, extra = p.parse_known_args()
    name = f"benchmark_{o.config.stem}_{o.method.replace(' ', '_')}"
    table = [r for r in csv.DictReader(o.out.open()) if r["run"] != o.method] if o.out.exists() else []
    table += [row for seed in o.seeds for row in rows(run(o.config, seed, extra, name), o.method)]
    with o.out.open("w", newline="") as f:
        writer = csv.DictWriter(f, FIELDS)
        writer.writeheader()
        writer.writerows(table)
    print(o.out.read_text(), f"({platform.machine()})")


if __name__ == "__main__":
    main()

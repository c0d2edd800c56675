"""Does IDAPT carry a task from source to hard within the budget of a laptop? Seeds, one row a policy.

    python benchmarks/quick.py --seeds 0 1 2 3 4                 # the pendulum
    python benchmarks/quick.py --config fetch_quick --seeds 0

Runs ``idapt fit`` with a quick config for every seed (finished runs are not repeated) and writes
results/<config>.csv: direct transfer, visual grounding alone and every grounding step stand side by side. ``grounded``
is the same policy in the grounded source. ``position_error`` and ``velocity_error`` are how wrong it is in the target
about components that are rates of one another: mean absolute errors [rad and m, rad/s and m/s]. ``minutes`` are of a
run on ``threads`` threads.
Failures stay in the table. An ablation gets rows of its own:

    python benchmarks/quick.py --seeds 3 --method "no resets" --visual.reset_weight 0
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded

from benchmarks.tables import replace_rows

from idapt_pl.tasks import make_task

FIELDS = (
    "task",
    "target",
    "run",
    "method",
    "seed",
    "grounding_step",
    "metric",
    "mean",
    "std",
    "psnr",
    "grounded",
    "position_error",
    "velocity_error",
    "target_interactions",
    "minutes",
    "threads",
    "commit",
    "cpu",
)

OTHER_ENGINE = ("fetch_reach", "sawyer_push")
"""Tasks whose hard target Filament draws; without Vulkan the classic renderer does, and it is another target."""


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
    """Rows of the results table: the task's metric over the episodes, G's error against paired target images (dB)."""

    def read(name: str) -> dict:
        return json.loads((folder / f"{name}.json").read_text())

    summary, provenance = read("summary"), read("run")
    if (summary["target"], provenance["filament"]) == ("hard", False) and summary["task"] in OTHER_ENGINE:
        method += ", classic renderer"
    common = {
        "task": summary["task"],
        "target": summary["target"],
        "run": method,
        "seed": summary["seed"],
        "metric": summary["metric"],
        "commit": provenance["git_commit"],
        "cpu": provenance["cpu"],
        "threads": provenance["cpu_threads"],
        "target_interactions": summary["target_interactions"],
        "minutes": round(summary["wall_s"] / 60, 1),
    }
    rates = make_task(summary["task"]).rates
    found = [("direct transfer", "", read("step_00/direct_transfer"), {})]
    for k in range(len(summary["grounded"]) + 1):
        if (folder / f"step_{k:02d}/evaluation.json").exists():  # else step k was settled: the policy before it stays
            measured = read(f"step_{k:02d}/evaluation")
        name = method if k else "visual only"
        beside = {"psnr": measured["translation"].get("psnr", ""), "grounded": round(measured["grounded"]["mean"], 2)}
        found.append((name, k, measured["target"], beside))
    if summary["oracle"] is not None:
        found.append(("oracle", "", read("step_00/oracle_evaluation"), {}))
    return [
        {**common, "method": name, "grounding_step": k, "mean": round(r["mean"], 2), "std": round(r["std"], 2)}
        | beside | errors_by_kind(r.get("state_errors", {}), rates)
        for name, k, r, beside in found
    ]  # fmt: skip


def errors_by_kind(errors: dict, rates: Mapping[int, int]) -> dict[str, float]:
    """What a policy takes for the state, in the mean over positions and over velocities, if the task tells which."""
    told = errors.get("estimates", errors.get("readings"))
    if not told or not rates:
        return {}
    kinds = {"position_error": rates.values(), "velocity_error": rates}
    return {name: round(statistics.fmean(told[i] for i in indices), 4) for name, indices in kinds.items()}


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--config", default="pendulum_quick", help="name of a file in configs/, without .yaml")
    p.add_argument("--method", default="IDAPT", help="name in the table, for ablations")
    p.add_argument("--out", type=Path, help="default results/<config>.csv")
    o, extra = p.parse_known_args()
    o.out = o.out or ROOT / f"results/{o.config}.csv"
    name = f"benchmark_{o.config}_{o.method.replace(' ', '_')}"
    for seed in o.seeds:
        new = rows(run(ROOT / f"configs/{o.config}.yaml", seed, extra, name), o.method)
        replace_rows(o.out, new, ("run", "seed"), FIELDS)
    print(o.out.read_text())


if __name__ == "__main__":
    main()

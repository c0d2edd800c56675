"""What do the paper's baselines and ablations reach, with the same settings, seeds and evaluation as the method?

    python benchmarks/baselines.py --seeds 0                                  # all of METHODS, one after the other
    python benchmarks/baselines.py --methods dr_wide cc_image --seeds 0 1 2
    python benchmarks/baselines.py --config cheetah_quick --methods idapt dr_narrow data_backwards

A method is a preset over a config: ``idapt fit --config configs/<config>.yaml --config configs/presets/<method>.yaml``;
``idapt`` is the config as it is. Finished runs are not repeated. Writes results/baselines.csv: ``mean`` and ``std`` are
of the run's last policy in the target, ``trained`` what a policy of the source alone (``method: source``) has in the
worlds that it trained in, ``target_interactions`` what it trained with there, ``reference_interactions`` those of the
oracle. Failures stay in the table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from quick import run
from tables import replace_rows

ROOT = Path(__file__).parents[1]
METHODS = (
    "direct_transfer", "oracle", "idapt", "dr_narrow", "dr_paper_narrow", "dr_wide", "adaptive_rl", "cc_state",
    "cc_image", "visual_only", "no_state_reconstruction", "accumulate", "newest_data", "dr_grounded", "data_random",
    "data_expert", "data_random_expert", "paper_small",
)  # fmt: skip
LOCOMOTION = ("data_backwards", "data_random_backwards_expert")
"""Beside them, of robots that can walk backwards."""
FIELDS = (
    "config", "task", "target", "method", "seed", "metric", "mean", "std", "episodes", "trained", "target_interactions",
    "reference_interactions", "minutes", "threads", "commit", "cpu",
)  # fmt: skip


def row(folder: Path, config: str, method: str) -> dict:
    """The row of a finished run."""

    def read(name: str) -> dict:
        return json.loads((folder / f"{name}.json").read_text())

    summary, provenance, ledger = read("summary"), read("run"), read("ledger")
    last = {"source": "step_00/direct_transfer", "oracle": "step_00/oracle_evaluation"}.get(summary["method"])
    measured = read(last) if last else last_evaluation(folder)["target"]
    return {
        "config": config,
        "task": summary["task"],
        "target": summary["target"],
        "method": method,
        "seed": summary["seed"],
        "metric": summary["metric"],
        "mean": round(summary["result"], 2),
        "std": round(measured["std"], 2),
        "episodes": summary["episodes"],
        "trained": trained(folder) if summary["method"] == "source" else "",
        "target_interactions": summary["target_interactions"],
        "reference_interactions": sum(e["count"] for e in ledger["entries"] if e["purpose"] == "oracle reference"),
        "minutes": round(summary["wall_s"] / 60, 1),
        "threads": provenance["cpu_threads"],
        "commit": provenance["git_commit"],
        "cpu": provenance["cpu"],
    }


def trained(folder: Path) -> float | str:
    """What the source's policy had in trials where it trained, if there were any."""
    notes = json.loads((folder / "step_00/source_policy/stage.json").read_text())
    return notes.get("trial_after", "")


def last_evaluation(folder: Path) -> dict:
    """What was measured after the last grounding step that trained a policy."""
    return json.loads(max(folder.glob("step_*/evaluation.json")).read_text())


def main() -> None:
    """Run the benchmark."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="pendulum_quick", help="name of a file in configs/, without .yaml")
    p.add_argument("--methods", nargs="+", help="names of files in configs/presets/, or idapt; default: all")
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--out", type=Path, default=ROOT / "results/baselines.csv")
    o, extra = p.parse_known_args()
    walks = o.config.startswith(("cheetah", "walker"))
    for method in o.methods or (*METHODS, *(LOCOMOTION if walks else ())):
        preset = [] if method == "idapt" else ["--config", str(ROOT / f"configs/presets/{method}.yaml")]
        for seed in o.seeds:
            folder = run(ROOT / f"configs/{o.config}.yaml", seed, [*preset, *extra], f"baselines_{o.config}_{method}")
            replace_rows(o.out, [row(folder, o.config, method)], ("config", "method", "seed"), FIELDS)
    print(o.out.read_text())


if __name__ == "__main__":
    main()

"""Does finding effects from images save target interactions? IDAPT with and without it, on the same data.

    python benchmarks/curves.py --seeds 0 1 2 3 4
    python benchmarks/curves.py --seeds 0 1 2 --images 2500 --methods "with effects" --schedule.grounding_steps 0

For each seed and number of exploratory target interactions a quick config is run twice, with ``--effects.discover``
false and true. The second run takes over what both have in common, everything up to the first search
for effects, so that they differ in nothing else. Writes results/curves.csv, a row a policy: the target
interactions up to then (training only), its return in the target, and which effects had been added to the source; and
the figure results/curves.png, a panel a config, which ``--draw`` draws anew.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from quick import ROOT, run
from tables import read_rows, replace_rows

from idapt_pl.report.plots import AFTER, BEFORE, STYLE

COMMON = ("target", "source", "state_predictor", "source_policy", "source_teacher", "source_student", "visual",
          "translated", "estimator", "direct_transfer")  # fmt: skip
"""Stages of step 0 that come before effects are looked for."""
KEY = ("config", "images", "seed", "method")
WITHOUT, WITH = METHODS = ("without", "with effects")


def take_over(done: Path, folder: Path) -> None:
    """Give a new run what it would do just as another one has."""
    if folder.exists():
        return
    temporary = folder.with_suffix(".copy")
    shutil.rmtree(temporary, ignore_errors=True)
    (temporary / "step_00").mkdir(parents=True)
    for path in (done / "step_00").iterdir():
        if path.name.split(".")[0] in COMMON:
            (shutil.copytree if path.is_dir() else shutil.copy2)(path, temporary / "step_00" / path.name)
    temporary.rename(folder)


def rows(folder: Path, about: dict) -> list[dict]:
    """A row for the source's policy and one for that of each grounding step."""

    def read(name: str) -> dict:
        path = folder / f"{name}.json"
        return json.loads(path.read_text()) if path.exists() else {}

    summary, commit = read("summary"), read("run")["git_commit"]
    measured = [("source", "", read("step_00/direct_transfer"))]
    steps = range(len(summary["grounded"]) + 1)
    measured += [("grounded", k, read(f"step_{k:02d}/evaluation")["target"]) for k in steps]
    interactions = {k: sum(e["count"] for e in training_entries(folder) if e["step"] <= k) for k in steps}
    found, table = [], []
    for policy, k, result in measured:
        if policy == "grounded":
            found += [
                f"{e['effect']}({e['target']}) = " + ", ".join(f"{v:.4g}" for v in e["parameters"].values())
                for e in read(f"step_{k:02d}/effects").get("effects", ())
            ]
        table.append(about | {
            "policy": policy, "grounding_step": k, "target_interactions": interactions.get(k, 0),
            "mean": round(result["mean"], 2), "std": round(result["std"], 2), "effects": " + ".join(found),
            "minutes": round(summary["wall_s"] / 60, 1), "commit": commit,
        })  # fmt: skip
    return table


def training_entries(folder: Path) -> list[dict]:
    """The ledger's entries of training."""
    entries = json.loads((folder / "ledger.json").read_text())["entries"]
    return [e for e in entries if e["purpose"] == "training"]


def curves(table: Sequence[dict[str, str]], config: str, method: str) -> dict[str, list[np.ndarray]]:
    """Target interactions and returns of every run, (policies, 2) each, by exploratory interactions."""
    found: dict[str, dict[str, list]] = {}
    for row in table:
        if (row["config"], row["method"]) == (config, method):
            point = int(row["target_interactions"]), float(row["mean"])
            found.setdefault(row["images"], {}).setdefault(row["seed"], []).append(point)
    return {images: [np.array(c) for c in seeds.values()] for images, seeds in found.items()}


def draw(table: Sequence[dict[str, str]], path: Path) -> None:
    """Return in the target against target interactions: each seed, thin, and their mean; a panel a config."""
    configs = dict.fromkeys(row["config"] for row in table)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4 * len(configs), 4.0), layout="constrained")
        for axis, config in zip(figure.subplots(1, len(configs), squeeze=False)[0], configs, strict=True):
            for method, colour in ((WITHOUT, BEFORE), (WITH, AFTER)):
                budgets = curves(table, config, method)
                for (images, seeds), style in zip(budgets.items(), ("-", "--", ":", "-."), strict=False):
                    for one in seeds:
                        axis.plot(*one.T, style, color=colour, lw=0.7, alpha=0.5)
                    label = f"{method}, {images} images, {len(seeds)} seed{'s' * (len(seeds) > 1)}"
                    axis.plot(*np.mean(seeds, 0).T, style, color=colour, marker="o", ms=5, lw=2, label=label)
            axis.set(title=config, xlabel="target interactions for training", ylabel="return in the target")
            axis.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(0, -0.17))
        figure.savefig(path, dpi=110)


def main() -> None:
    """Run what is missing, keep the table and draw it."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--config", default="pendulum_quick", help="name of a file in configs/, without .yaml")
    p.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    p.add_argument("--images", type=int, nargs="+", default=[5000], help="exploratory target interactions")
    p.add_argument("--methods", choices=METHODS, nargs="+", default=METHODS)
    p.add_argument("--draw", action="store_true", help="run nothing, only draw what is there")
    p.add_argument("--out", type=Path, default=ROOT / "results/curves.csv")
    o, extra = p.parse_known_args()
    for images in o.images if not o.draw else ():
        for seed in o.seeds:
            about = {"config": o.config, "images": images, "seed": seed}
            config, name = ROOT / f"configs/{o.config}.yaml", f"curves_{o.config}_{images}"
            settings = ["--schedule.images", str(images), *extra, "--effects.discover"]
            if WITHOUT in o.methods:
                plain = run(config, seed, [*settings, "false"], name)
                replace_rows(o.out, rows(plain, about | {"method": WITHOUT}), KEY)
                take_over(plain, ROOT / f"runs/{name}_effects_{seed}")
            if WITH in o.methods:
                repaired = run(config, seed, [*settings, "true"], f"{name}_effects")
                replace_rows(o.out, rows(repaired, about | {"method": WITH}), KEY)
    draw(read_rows(o.out), o.out.with_suffix(".png"))


if __name__ == "__main__":
    main()

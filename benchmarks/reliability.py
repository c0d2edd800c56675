"""Are the probabilities of a diagnosis' explanations right as often as they say? One row an explanation.

    python benchmarks/reliability.py --seeds 20 21         # finished cases are kept
    python benchmarks/reliability.py --summary             # the table and the plot of what is there

One to three effects are drawn by the seed from the single ones of benchmarks/undeclared (see several_effects.py). Every
second case is recorded poorly: three short episodes, positions alone. An explanation is right if its effects are just
those that were hidden, so of several that no recording can tell apart one is; ``something else`` is right if none is.
Writes results/reliability.csv and results/reliability.png, and results/false_discoveries.csv: how probable each effect
is that is named, and whether it is there.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import matplotlib.pyplot as plt
import mujoco
import numpy as np
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.several_effects import Drawn, draw
from benchmarks.undeclared.generate import generate
from cli.provenance import git_commit
from datamodules import Trajectories, read_trajectories
from idapt_pl.diagnosis.answer.false_discoveries import nameable
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "model", "hidden", "seed", "recorded", "truth", "explanation", "standing", "probability", "right", "loss",
    "seconds", "commit",
)  # fmt: skip
EFFECT_FIELDS = (
    "model", "hidden", "seed", "recorded", "truth", "effect", "share", "other", "probability", "right", "seconds",
    "commit",
)  # fmt: skip
MODELS = ("inverted_pendulum", "reacher", "servo_arm", "rotary_pendulum", "dc_arm", "double_pendulum", "swimmer")
COUNTS = (1, 2, 3)
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)
SOMETHING_ELSE = "something else"


def poorly(data: Trajectories) -> Trajectories:
    """Three of the episodes, the first half of each, without velocities."""
    episodes = []
    for e in tuple(data)[:3]:
        steps = max(len(e.actions) // 2, 20)
        seen = {k: v[: steps + 1] for k, v in e.observations.items() if k != "qvel"}
        episodes.append(replace(e, actions=e.actions[:steps], observations=seen, infos={}))
    return replace(data, episodes=tuple(episodes))


def is_right(drawn: Drawn, effects: list[dict], spec: mujoco.MjSpec) -> bool:
    """Whether effects are those that were hidden. All motors are one where there is but one."""
    model = spec.copy().compile()

    def plain(effect: str, target: str) -> tuple[str, str]:
        alone = effect.startswith("actuator") and target == "*" and model.nu == 1
        return effect, model.actuator(0).name if alone else target

    named = {plain(e["effect"], e["target"]) for e in effects if e["effect"] != "numerics"}
    return named == {plain(t.effect, t.target) for t in drawn.case.truth}


def effect_rows(drawn: Drawn, found: Sequence[dict], explanations: Sequence[dict]) -> list[dict]:
    """Each effect that is named: its share of the explanations, its probability, and whether it is there."""
    told, answers = sum(e["probability"] for e in explanations), set().union(*itertools.chain(*drawn.answers))
    made = []
    for e in found:
        key = e["effect"], e["target"]
        share = sum(x["probability"] for x in explanations if key in [(q["effect"], q["target"]) for q in x["effects"]])
        made.append({
            "effect": f"{key[0]}({key[1]})", "share": round(share / max(told, 1e-9), 4), "other": round(1 - told, 4),
            "probability": e["probability"], "right": int(key in answers),
        })  # fmt: skip
    return made


def run(model: str, count: int, seed: int) -> tuple[list[dict], list[dict]]:
    """Record, diagnose, and compare every explanation, and every effect, with what was hidden."""
    drawn, poor = draw(model, count, seed), (MODELS.index(model) + count + seed) % 2 == 1
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(drawn.case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    started = time.perf_counter()
    report = diagnose(spec, poorly(data) if poor else data, seed=seed).report
    common = {
        "model": model, "hidden": count, "seed": seed, "recorded": "poorly" if poor else "well",
        "truth": " + ".join(f"{t.effect}({t.target})" for t in drawn.case.truth),
        "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip
    rows = [
        common
        | {
            "explanation": " + ".join(f"{x['effect']}({x['target']})" for x in e["effects"]),
            "standing": e["standing"], "probability": e["probability"], "loss": e["loss"],
            "right": int(is_right(drawn, e["effects"], spec)),
        }
        for e in report["explanations"]
    ]  # fmt: skip
    left = round(1.0 - sum(r["probability"] for r in rows), 4)
    none_is = int(not any(r["right"] for r in rows))
    rows.append(common | {"explanation": SOMETHING_ELSE, "standing": "", "probability": left, "right": none_is})
    named = [e for e in report["effects"] if e["effect"] != "numerics"]
    return rows, [common | e for e in effect_rows(drawn, named, report["explanations"])]


def bins(rows: list[dict]) -> list[tuple[float, float, int, float, float]]:
    """For each bin: mean probability, share that is right, number, and ends of Wilson's 95 % interval."""
    p, right = (np.array([float(r[k]) for r in rows]) for k in ("probability", "right"))
    out = []
    for low, high in itertools.pairwise(EDGES):
        of = (p >= low) & (p < high if high < 1 else p <= high)
        n = int(of.sum())
        if not n:
            continue
        share, z = float(right[of].mean()), 1.96
        middle, half = share + z**2 / (2 * n), z * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
        ends = (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)
        out.append((float(p[of].mean()), share, n, *ends))
    return out


def summarise(rows: list[dict]) -> str:
    """A Markdown table of the bins, and Brier's score beside that of saying the base rate."""
    lines = ["| said, mean | right | 95 % | explanations |", "|---|---|---|---|"]
    lines += [f"| {p:.2f} | {s:.2f} | {a:.2f} to {b:.2f} | {n} |" for p, s, n, a, b in bins(rows)]
    p, right = (np.array([float(r[k]) for r in rows]) for k in ("probability", "right"))
    brier, base = np.mean(np.square(p - right)), right.mean() * (1 - right.mean())
    return "\n".join([*lines, "", f"Brier's score {brier:.3f}; always saying {right.mean():.2f} has {base:.3f}"])


def summarise_rates(rows: list[dict], rates: Sequence[float] = (0.05, 0.1, 0.2)) -> str:
    """A Markdown table: of the effects that each ``--fdr`` would name, how many are not there; last, of all."""
    cases: dict[tuple, list[dict]] = {}
    for r in rows:
        cases.setdefault((r["model"], r["hidden"], r["seed"]), []).append(r)
    lines = ["| `--fdr` | named | not there | there, not named |", "|---|---|---|---|"]
    there = sum(int(r["right"]) for r in rows)
    for rate in (*rates, None):
        kept = []
        for case in cases.values():
            probable = {(r["effect"], str(i)): float(r["probability"]) for i, r in enumerate(case)}
            names = set(probable) if rate is None else nameable(probable, rate)
            kept += [int(r["right"]) for i, r in enumerate(case) if (r["effect"], str(i)) in names]
        told = "not given" if rate is None else f"{rate:g}"
        lines.append(f"| {told} | {len(kept)} | {len(kept) - sum(kept)} | {there - sum(kept)} |")
    return "\n".join(lines)


def draw_plot(rows: list[dict], path: Path) -> None:
    """Share that is right over what was said."""
    said, right, n, low, high = np.array(bins(rows)).T
    figure, axes = plt.subplots(figsize=(4.5, 4.2), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    axes.errorbar(said, right, yerr=[right - low, high - right], fmt="o", capsize=3)
    for x, y, k in zip(said, right, n, strict=True):
        axes.annotate(f"{int(k)}", (x, y), xytext=(6, -10), textcoords="offset points", fontsize=8)
    axes.set(xlabel="probability that was said", ylabel="share that is right (95 %)", xlim=(0, 1), ylim=(0, 1))
    figure.savefig(path, dpi=120)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", default=MODELS, choices=MODELS)
    parser.add_argument("--counts", nargs="+", type=int, default=COUNTS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "reliability.csv")
    parser.add_argument("--summary", action="store_true", help="only print the table and draw the plot")
    o = parser.parse_args()
    rows = read_rows(o.out)
    done = {(r["model"], int(r["hidden"]), int(r["seed"])) for r in rows}
    cases = [(m, c, s) for s in o.seeds for m in o.models for c in o.counts if (m, c, s) not in done]
    by_effect = o.out.with_name("false_discoveries.csv")
    effects = read_rows(by_effect)
    for case in tqdm([] if o.summary else cases):
        new, named = run(*case)
        rows, effects = rows + new, effects + named
        write_rows(o.out, rows, FIELDS)
        write_rows(by_effect, effects, EFFECT_FIELDS)
    chosen = rows if o.summary else [r for r in rows if int(r["seed"]) in o.seeds]
    print(summarise(chosen))
    print(summarise_rates([r for r in effects if o.summary or int(r["seed"]) in o.seeds]))
    draw_plot(chosen, o.out.with_suffix(".png"))


if __name__ == "__main__":
    main()

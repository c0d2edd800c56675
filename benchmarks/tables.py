"""Tables of results: CSV files that benchmarks add to as they go, and the tables of the pages made from them.

    python benchmarks/tables.py           # the table of README.md: means and 95 % intervals over seeds
    python benchmarks/tables.py easy      # the same of the easy targets; quick: of the quick configs
    python benchmarks/tables.py cheetah   # every run of HalfCheetah, version by version; likewise the other tasks
    python benchmarks/tables.py kept      # what the target keeps of the return in the grounded source, run by run
    python benchmarks/tables.py baselines  # the paper's baselines and ablations beside the method
    python benchmarks/tables.py cost      # what diagnoses simulate
    python benchmarks/tables.py own       # sources and targets of others
    python benchmarks/tables.py next      # recordings until a diagnosis names one effect

``python benchmarks/figures.py`` writes them into the pages. The benchmarks import what reads and writes the CSV files.
"""

from __future__ import annotations

import argparse
import csv
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from idapt_pl.evaluation.paper import PAPER_RESULTS
from idapt_pl.files import write_atomically

Row = Mapping[str, object]
RESULTS = Path(__file__).parents[1] / "results"
TASKS = {
    "inverted_pendulum": "InvertedPendulum",
    "half_cheetah": "HalfCheetah",
    "walker2d": "Walker2d",
    "fetch_reach": "Fetch-Reach",
    "sawyer_push": "Sawyer-Push",
}
SHOWN = (
    ("inverted_pendulum", "pendulum", {"run": "IDAPT"}),
    ("half_cheetah", "cheetah", {"run": "IDAPT"}),
    ("walker2d", "walker", {"run": "IDAPT"}),
    ("fetch_reach", "fetch", {"run": "IDAPT"}),
    ("sawyer_push", "sawyer", {"run": "IDAPT"}),
)
"""Rows of README's table: task, its tables, and which of their rows. The rest is in the table of every run."""
FIRST_STEPS = {"cheetah_quick": ("cheetah_hard", 1, 5000), "walker_quick": ("walker_hard", 1, 5000)}
"""Configs that are another one's first grounding steps: its table, how many, the target's control steps up to there."""


PAPER_NAMES = {
    "dr_paper_narrow": "DR-Narrow", "dr_wide": "DR-Wide", "adaptive_rl": "Adaptive RL", "cc_state": "CC-State",
    "cc_image": "CC-Image", "visual_only": "Visual Only", "idapt": "IDAPT", "paper_small": "IDAPT",
}  # fmt: skip
"""Presets and what the paper calls the like."""


def read_rows(path: Path) -> list[dict]:
    """The rows of a table as text; none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as f:
        return list(csv.DictReader(f))


def write_rows(path: Path, rows: Iterable[Row], fields: Sequence[str] = ()) -> None:
    """Write a table.

    Args:
        path: of the file; its folder is made.
        rows: what is missing in a row is left empty.
        fields: the columns; default those of all rows, in order of appearance.
    """
    rows = list(rows)
    columns = fields or list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)

    def dump(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as f:
            table = csv.DictWriter(f, columns, lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    write_atomically(path, dump)


def replace_rows(path: Path, rows: Sequence[Row], key: Sequence[str], fields: Sequence[str] = ()) -> None:
    """Put rows into a table in place of those that agree with one of them in the columns ``key``."""

    def identity(row: Row) -> tuple[str, ...]:
        return tuple(str(row[k]) for k in key)

    new = {identity(row) for row in rows}
    write_rows(path, [*(row for row in read_rows(path) if identity(row) not in new), *rows], fields)


def mean_and_interval(values: Sequence[float], metric: str = "return") -> str:
    """Mean and half of Student's 95 % interval over seeds. Of two seeds, whose interval says nothing, both values."""
    digits = 2 if metric == "success" else 0
    if len(values) < 3:
        return ", ".join(dict.fromkeys(f"{value:.{digits}f}" for value in values))
    half = stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):.{digits}f} ± {half:.{digits}f}"


def chosen(rows: Iterable[Row], wanted: Row) -> list[Row]:
    """The rows that have these values."""
    return [row for row in rows if all(row[k] == v for k, v in wanted.items())]


def by_stage(rows: Iterable[Row]) -> list[list[float]]:
    """Returns in the target of every seed: of direct transfer, after step 0, and after the last step; no oracles."""
    found: dict[str, dict[str, float]] = {}
    for row in rows:
        if row["method"] != "oracle":
            found.setdefault(str(row["seed"]), {})[str(row["grounding_step"])] = float(str(row["mean"]))
    steps = [sorted((k for k in seed if k), key=int) for seed in found.values()]
    columns = [["" for _ in steps], ["0" for _ in steps], [k[-1] if k[1:] else None for k in steps]]
    return [[seed[k] for seed, k in zip(found.values(), column, strict=True) if k in seed] for column in columns]


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table for a page."""
    above, *below = (f"| {' | '.join(line)} |" for line in (head, *rows))
    return "\n".join((above, "|---" * len(head) + "|", *below))


def rows_of(table: str, wanted: Row, results: Path) -> list[dict]:
    """The rows of a config's table that have these values; of a config that another begins with, that one's too."""
    mine = chosen(read_rows(results / f"{table}.csv"), wanted)
    if table not in FIRST_STEPS:
        return mine
    longer, steps, interactions = FIRST_STEPS[table]
    own = {row["seed"] for row in mine}
    first = [row for row in rows_of(longer, wanted, results) if int(row["grounding_step"] or 0) <= steps]
    return [row | {"target_interactions": str(interactions)} for row in first if row["seed"] not in own] + mine


def summary(results: Path = RESULTS, size: str = "hard") -> str:
    """README's table, or the same of the easy targets or of the quick configs, whose targets are hard."""
    bounds, lines, target = read_rows(results / "bounds.csv"), [], "easy" if size == "easy" else "hard"
    for task, tables, wanted in SHOWN:
        table = f"{tables}_{size}"
        mine = rows_of(table, wanted, results)
        if not mine:
            continue  # not run yet
        metric = "success" if task in ("fetch_reach", "sawyer_push") else "return"
        oracles = chosen(bounds, {"task": task, "domain": target, "policy": "oracle", "metric": metric})
        measured = [*by_stage(mine), [float(row["mean"]) for row in oracles]]
        seeds, most = len({row["seed"] for row in mine}), max(int(row["target_interactions"] or 0) for row in mine)
        told = [mean_and_interval(m, metric) for m in measured]
        name = ", ".join((f"`{table}`", *wanted["run"].split(", ")[1:], metric))
        lines.append((name, str(seeds), f"{most:,}", *told, f"{round(PAPER_RESULTS[task, target]['IDAPT'], 2):g}"))
    head = ("config, metric", "seeds", "target steps", "direct transfer", "step 0", "last step", "oracle", "paper")
    return markdown(head, lines)


def kept(results: Path = RESULTS) -> str:
    """A row for each run of the configs as they are: its last policy in the target beside the grounded source.

    Rows from before the grounded source was kept in the tables are left out.
    """
    lines = []
    for size in ("hard", "easy", "quick"):
        for _, name, wanted in SHOWN:
            table = f"{name}_{size}"
            rows = [row for row in chosen(read_rows(results / f"{table}.csv"), wanted) if row.get("grounded")]
            last = {row["seed"]: row for row in sorted(rows, key=lambda row: int(row["grounding_step"]))}
            for seed in sorted(last, key=int):
                row = last[seed]
                there, here = float(row["mean"]), float(row["grounded"])
                digits = 2 if row["metric"] == "success" else 0
                told = [f"{there:.{digits}f}", f"{here:.{digits}f}", f"{there / here:.0%}".replace("%", " %")]
                told += [row.get("position_error") or "", row.get("velocity_error") or "", row["psnr"]]
                lines.append((f"`{table}`", seed, *told))
    head = (
        "config",
        "seed",
        "target",
        "grounded source",
        "kept",
        "positions' error",
        "velocities' error",
        "PSNR of G, dB",
    )
    return markdown(head, lines)


def versions(rows: Iterable[Row]) -> str:
    """The commits that rows come from, in their order; with ``+`` where files had been changed since."""
    commits = dict.fromkeys(str(row["commit"]) for row in rows)
    return " ".join(dict.fromkeys(c[:7] + "+" * c.endswith("dirty") for c in commits))


def every_run(results: Path = RESULTS, name: str = "cheetah") -> str:
    """A row for each run of a task that is in its tables; the pendulum has those of the curves besides."""
    keys: dict[str, tuple[str, ...]] = {f"{name}_{size}": ("run",) for size in ("hard", "easy", "quick")}
    if name == "pendulum":
        keys["curves"] = ("config", "images", "method")
    lines = []
    for table, key in keys.items():
        rows = read_rows(results / f"{table}.csv")
        for wanted in dict.fromkeys(tuple(row[k] for k in key) for row in rows):
            mine = sorted(chosen(rows, dict(zip(key, wanted, strict=True))), key=lambda row: int(row["seed"]))
            seeds, metric = " ".join(sorted({row["seed"] for row in mine})), mine[0].get("metric", "return")
            told = [mean_and_interval(values, metric) for values in by_stage(mine)]
            cpus = "; ".join(dict.fromkeys(str(row["cpu"]).removeprefix("AMD ") for row in mine if row.get("cpu")))
            lines.append((f"`{table}.csv`", ", ".join(wanted), seeds, *told, versions(mine), cpus))
    return markdown(("table", "run", "seeds", "direct transfer", "step 0", "last step", "commits", "CPU"), lines)


def baselines(results: Path = RESULTS) -> str:
    """A row for each config and method that was run beside others, in the order of their presets' table."""
    rows, lines = read_rows(results / "baselines.csv"), []
    for config, method in dict.fromkeys((r["config"], r["method"]) for r in rows):
        mine = sorted(chosen(rows, {"config": config, "method": method}), key=lambda r: int(r["seed"]))
        metric, paper = mine[0]["metric"], PAPER_RESULTS[mine[0]["task"], mine[0]["target"]]
        steps = max(int(r["target_interactions"]) for r in mine)
        of_oracle = max(int(r["reference_interactions"]) for r in mine)
        told = paper.get(PAPER_NAMES.get(method, ""), "")
        lines.append((
            f"`{config}`", f"`{method}`", " ".join(r["seed"] for r in mine),
            mean_and_interval([float(r["mean"]) for r in mine], metric),
            f"{of_oracle:,} of the oracle" if of_oracle else f"{steps:,}", str(told), versions(mine),
        ))  # fmt: skip
    return markdown(("config", "method", "seeds", "mean in the target", "target steps", "paper", "commits"), lines)


def search_cost(results: Path = RESULTS) -> str:
    """What diagnoses simulate, of the earliest version and the latest: cases that have rows of two."""
    rows, lines = read_rows(results / "search_cost.csv"), []
    for case in dict.fromkeys((r["model"], r["hidden"], r["seed"]) for r in rows):
        of = [r for r in rows if (r["model"], r["hidden"], r["seed"]) == case]
        first, last = of[0], of[-1]
        if first is last:
            continue
        changed = [f"{first[k]} to {last[k]}" for k in ("steps_m", "cpu_s")]
        names = [sorted(r["found"].split(" + ")) for r in (first, last)]
        found = "the same" if names[0] == names[1] else f"{first['found']}; now {last['found']}"
        lines.append((*case, *changed, f"{float(first['loss']):.3f} to {float(last['loss']):.3f}", found))
    titles = ("recordings of", "hidden effects", "seed", "million time steps", "CPU seconds", "error left", "found")
    return markdown(titles, lines)


def two_models(results: Path = RESULTS) -> str:
    """A row for each difference between two published models of one robot that is there or was found, by seeds."""
    rows, lines = read_rows(results / "two_models.csv"), []
    seeds = sorted({r["seed"] for r in rows}, key=int)
    for effect, target, parameter in dict.fromkeys((r["effect"], r["target"], r["parameter"]) for r in rows):
        mine = {r["seed"]: r for r in chosen(rows, {"effect": effect, "target": target, "parameter": parameter})}
        told = {k: next((v for r in mine.values() if (v := r[k])), "") for k in ("nominal", "truth")}
        found = [mine[s]["estimate"] if s in mine else "" for s in seeds]
        lines.append((
            f"`{effect}` of `{target}`, {parameter}", told["nominal"], told["truth"] or "as in the model",
            *(f"{float(v):.3g}" if v else "not named" for v in found),
        ))  # fmt: skip
    return markdown(("", "in the model", "in the other file", *(f"found, seed {s}" for s in seeds)), lines)


def own_worlds(results: Path = RESULTS) -> str:
    """A row for each pair of a source and a target that nobody here wrote, and each of its versions."""
    rows, lines = read_rows(results / "own_targets.csv"), []
    for task, target, run in dict.fromkeys((r["task"], r["target"], r["run"]) for r in rows if r["run"] != "oracle"):
        mine = chosen(rows, {"task": task, "target": target, "run": run})
        oracles = [float(r["mean"]) for r in chosen(rows, {"task": task, "target": target, "run": "oracle"})]
        seeds, most = " ".join(dict.fromkeys(r["seed"] for r in mine)), max(int(r["target_interactions"]) for r in mine)
        told = [mean_and_interval(values) for values in (*by_stage(mine), oracles)]
        lines.append((f"`{task.split(':')[-1]}`", target, run, seeds, f"{most:,}", *told, versions(mine)))
    titles = ("source", "target", "run", "seeds", "target steps")
    return markdown((*titles, "direct transfer", "step 0", "last step", "oracle", "commits"), lines)


def next_recordings(results: Path = RESULTS) -> str:
    """What further recordings came to, method by method, where the first one left several explanations.

    The last column is how many plays of a method's first motion tell as much as one of ours: the square of how far the
    pair is apart that ours tells least, of those that it tells at all; the median.
    """
    confounded: dict[tuple[str, str, str], dict[str, dict]] = {}
    for row in read_rows(results / "excitation.csv"):
        if row["method"] != "none":
            confounded.setdefault((row["case"], row["seed"], row["duration"]), {})[row["method"]] = row
    lines = []
    for method in dict.fromkeys(m for of in confounded.values() for m in of):
        mine = [of[method] for of in confounded.values()]
        named = [int(r["recordings"]) for r in mine if r["outcome"] == "named"]
        others = (str(sum(r["outcome"] == name for r in mine)) for name in ("inseparable", "open", "wrong"))
        within = (f"{sum(n <= k for n in named)} of {len(mine)}" for k in (1, 2, 3))
        plays = [p for of in confounded.values() if (p := plays_beside_ours(of["excite"], of[method])) is not None]
        lines.append((method, *within, *others, f"{np.median(plays):.1f}"))
    titles = (
        "motion",
        "named after one",
        "two",
        "three",
        "said to be inseparable",
        "left open",
        "something else named",
    )
    return markdown((*titles, "plays for one of ours"), lines)


def plays_beside_ours(ours: Row, other: Row, told: float = 1.5) -> float | None:
    """Plays of another motion that tell as much of the hardest pair as one of ours; None where it tells none."""
    d, e = (np.array([float(x) for x in str(row["separation"]).split()]) for row in (ours, other))
    return (d[d >= told].min() / e[d >= told].min()) ** 2 if len(d) == len(e) and (d >= told).any() else None


TABLES: Mapping[str, Callable[[Path], str]] = {
    "hard": summary,
    "easy": functools.partial(summary, size="easy"),
    "quick": functools.partial(summary, size="quick"),
    "kept": kept,
    "baselines": baselines,
    "cost": search_cost,
    "own": own_worlds,
    "two_models": two_models,
    "next": next_recordings,
    **{name: functools.partial(every_run, name=name) for _, name, _ in SHOWN},
}
"""Tables of the pages, by the names that ``benchmarks/figures.py`` finds there."""


def main() -> None:
    """Print a table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("table", nargs="?", choices=TABLES, default="hard")
    print(TABLES[p.parse_args().table](RESULTS))


if __name__ == "__main__":
    main()

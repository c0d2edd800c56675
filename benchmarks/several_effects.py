"""Are several hidden effects all named, and no other? One row a model, number of effects and seed.

    python benchmarks/several_effects.py --seeds 0 1               # 2 to 4 effects; finished rows are kept
    python benchmarks/several_effects.py --models walker2d hopper --counts 3 --seeds 100
    python benchmarks/several_effects.py --summary                 # the table of what is there

Effects are drawn by the seed from the single ones of benchmarks/undeclared, none that could pass for another that was
drawn. Writes results/several_effects.csv: ``exact`` says that each hidden effect is named and nothing else is,
``missed`` and ``extra`` how many were not named or are not there. One without which the recordings would be the same,
such as an end stop that no joint comes to, is ``unseen``: it cannot be named, and does not count. An effect counts as
named, too, if it is in the list of what another one could also be; the table has a column for those where first names
alone are exact.
"""

from __future__ import annotations

import argparse
import itertools
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
import numpy as np
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from benchmarks.diagnosis import estimate
from benchmarks.undeclared.cases import CASES, FINE, SAME, Answer, Case, Truth
from benchmarks.undeclared.generate import generate, simulate
from benchmarks.undeclared.models import MODELS
from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis.search import diagnose

FIELDS = (
    "model", "hidden", "seed", "truth", "unseen", "found", "verdict", "exact", "missed", "extra", "before", "after",
    "relative_error", "covered", "seconds", "commit",
)  # fmt: skip

DEVELOPED_ON = ("inverted_pendulum", "reacher", "servo_arm", "half_cheetah")


@dataclass(frozen=True)
class Drawn:
    """Several effects in one world: the case to record, and for each effect the answers that are right."""

    case: Case
    answers: tuple[tuple[Answer, ...], ...]


def single_cases(model: str) -> list[Case]:
    """The cases of a model that hide one effect of the library."""
    return [c for c in CASES.values() if c.model == model and len(c.truth) == 1 and c.accept and c.amplitude == 1]


def draw(model: str, count: int, seed: int) -> Drawn:
    """Draw ``count`` effects of a model; none shares an accepted answer or the kind of effect with another."""
    rng = np.random.default_rng([seed, count])
    chosen: list[Case] = []
    pool = single_cases(model)
    for i in rng.permutation(len(pool)):
        taken = set().union(*(a for c in chosen for a in c.accept))
        kinds = {c.truth[0].effect for c in chosen}
        if not taken & set().union(*pool[i].accept) and pool[i].truth[0].effect not in kinds:
            chosen.append(pool[i])
        if len(chosen) == count:
            break
    else:
        raise SystemExit(f"{model}: no {count} of its {len(pool)} single effects go together; try fewer")
    case = Case(
        name=f"several_{model}_{count}",
        model=model,
        truth=tuple(c.truth[0] for c in chosen),
        kind="double",
        accept=tuple(frozenset().union(*answer) for answer in itertools.product(*(c.accept for c in chosen))),
        parts=tuple(c.parts[0] for c in chosen),
        numerics=SAME if all(c.numerics == SAME for c in chosen) else FINE,
        noise=MODELS[model].noise,
    )
    return Drawn(case, tuple(c.accept for c in chosen))


def matched(answers: tuple[tuple[Answer, ...], ...], effects: list[dict]) -> tuple[int, int]:
    """How many hidden effects are not named, and how many effects are named that are not there."""
    open_ones = [set().union(*a) for a in answers]
    extra = 0
    for e in effects:
        names = {(e["effect"], e["target"]), *((q["effect"], q["target"]) for q in e["equivalent"])}
        first = next((a for a in open_ones if (e["effect"], e["target"]) in a), None)
        hit = first or next((a for a in open_ones if names & a), None)
        if hit is None:
            extra += 1
        else:
            open_ones.remove(hit)
    return len(open_ones), extra


def unseen(case: Case, seed: int) -> tuple[str, ...]:
    """Effects of a case, as ``effect(target)``, without which its recordings would be the same to the last bit."""
    recorded = simulate(case, seed)

    def matters(k: int) -> bool:
        others = replace(case, parts=(*case.parts[:k], *case.parts[k + 1 :]))
        without = simulate(others, seed)
        return any(not np.array_equal(a.clean, b.clean) for a, b in zip(recorded, without, strict=True))

    return tuple(label(t) for k, t in enumerate(case.truth) if not matters(k))


def seen_answers(drawn: Drawn, hidden_away: Sequence[str]) -> tuple[tuple[Answer, ...], ...]:
    """The answers that are right for those effects that recordings can show."""
    return tuple(a for a, t in zip(drawn.answers, drawn.case.truth, strict=True) if label(t) not in hidden_away)


def label(t: Truth) -> str:
    """``effect(target)``, without spaces."""
    return f"{t.effect}({t.target})".replace(" ", "+")


def run(model: str, count: int, seed: int) -> dict:
    """Record, diagnose, compare."""
    drawn = draw(model, count, seed)
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(drawn.case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    started = time.perf_counter()
    report = diagnose(spec, data, seed=seed).report
    seconds = time.perf_counter() - started
    physical = [e for e in report["effects"] if e["effect"] != "numerics"]
    hidden_away = unseen(drawn.case, seed)
    missed, extra = matched(seen_answers(drawn, hidden_away), physical)
    shown = [
        f"{e['effect']}({e['target']}) " + " ".join(f"{k}={p['estimate']}" for k, p in e["parameters"].items())
        for e in physical
    ]
    return {
        "model": model, "hidden": count, "seed": seed,
        "truth": truth_of(drawn), "unseen": " ".join(hidden_away),
        "found": " + ".join(shown), "verdict": report["verdict"], "exact": int(not missed and not extra),
        "missed": missed, "extra": extra, **{k: report["error"][k] for k in ("before", "after")},
        **estimate(drawn.case, physical), "seconds": round(seconds, 1), "commit": git_commit(),
    }  # fmt: skip


def exact_by_first_names(row: dict) -> bool | None:
    """Whether the effects are right without what they could also be; None where the cases have changed since."""
    drawn = draw(row["model"], int(row["hidden"]), int(row["seed"]))
    if row["truth"] != truth_of(drawn):
        return None
    named = re.findall(r"(\w+)\(([^()]*)\)", row["found"])
    answers = seen_answers(drawn, (row.get("unseen") or "").split())
    return matched(answers, [{"effect": e, "target": t, "equivalent": []} for e, t in named]) == (0, 0)


def truth_of(drawn: Drawn) -> str:
    """What is hidden, as rows tell it."""
    return " + ".join(f"{t.effect}({t.target}) {t.parameter}={t.value}" for t in drawn.case.truth)


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row a number of hidden effects, models that were developed on apart from others."""
    lines = [
        "| models | hidden effects | cases | exact | exact by first names | named | named besides "
        "| intervals that cover | median s |",
        "|" + "---|" * 9,
    ]
    for known in (True, False):
        for count in sorted({int(r["hidden"]) for r in rows}):
            of = [r for r in rows if int(r["hidden"]) == count and (r["model"] in DEVELOPED_ON) == known]
            if not of:
                continue
            shown = [count - len((r.get("unseen") or "").split()) for r in of]
            named = [n - int(r["missed"]) for n, r in zip(shown, of, strict=True)]
            first = [exact for r in of if (exact := exact_by_first_names(r)) is not None]
            besides = sum(int(r["extra"]) for r in of)
            covered = [float(r["covered"]) for r in of if r["covered"] != ""]
            lines.append(
                f"| {'developed on' if known else 'others'} | {count} | {len(of)} | {sum(int(r['exact']) for r in of)} "
                f"| {sum(first)} of {len(first)} | {sum(named)} of {sum(shown)} | {besides} "
                f"| {np.mean(covered):.2f} | {np.median([float(r['seconds']) for r in of]):.0f} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=DEVELOPED_ON, choices=sorted(MODELS))
    p.add_argument("--counts", nargs="+", type=int, default=[2, 3, 4], help="how many effects are hidden")
    p.add_argument("--seeds", nargs="+", type=int, default=[0])
    p.add_argument("--again", action="store_true", help="run finished rows again")
    p.add_argument("--summary", action="store_true", help="print the table of what is there, and run nothing")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "several_effects.csv")
    o = p.parse_args()
    rows = {(r["model"], int(r["hidden"]), int(r["seed"])): r for r in read_rows(o.out)}
    todo = [k for k in itertools.product(o.models, o.counts, o.seeds) if (o.again or k not in rows) and not o.summary]
    for key in tqdm(todo, unit="case"):
        rows[key] = run(*key)
        write_rows(o.out, [rows[k] for k in sorted(rows)], FIELDS)
        r = rows[key]
        tqdm.write(f"{key} exact {r['exact']}: {r['truth']}\n    -> {r['verdict']}: {r['found']}")
    print(summarise(list(rows.values())))


if __name__ == "__main__":
    main()

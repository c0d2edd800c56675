"""Does the diagnosis need all its gates? The same recordings, searched with some of them and with all. One row a case.

    python benchmarks/fewer_gates.py --seeds 61                          # without those that keep out nothing alone
    python benchmarks/fewer_gates.py --seeds 61 --without noticeable
    python benchmarks/fewer_gates.py --summary                           # the table of what is there

Cases as in benchmarks/gates.py: controls and one to three effects, every second one recorded poorly. A case is searched
with the fewer gates, and all of ``idapt_pl/diagnosis/rounds/gates.py`` are asked besides; only where they would have
judged a candidate in another way (``parted``) is it searched a second time, with all. ``exact`` says that what is
hidden is named and nothing else, ``extra`` how many named effects are not there, ``loss`` is the held-out one with
them.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
from benchmarks.gates import recorded
from benchmarks.reliability import MODELS
from benchmarks.several_effects import matched, truth_of
from benchmarks.tables import read_rows, write_rows
from tqdm import tqdm

from cli.provenance import git_commit
from idapt_pl.diagnosis.rounds import acceptance
from idapt_pl.diagnosis.rounds.gates import GATES, Judged, objections
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.candidates.trial import Rejection, RejectionReason

NEVER_ALONE = ("within_sensors", "share_of_error", "noticeable")
"""Gates that object to no wrong effect of results/gates.csv that another one does not object to as well.

Five more were, and are gone; their names are in rows of earlier versions.
"""
GO_ON_BY = (RejectionReason.UNSURE_GAIN, RejectionReason.IMPLAUSIBLE)
"""Reasons by which a search goes on in another way than by others."""
FIELDS = (
    "model", "hidden", "seed", "recorded", "truth", "without", "parted", "exact", "exact_all", "extra", "extra_all",
    "found", "found_all", "loss", "loss_all", "seconds", "seconds_all", "commit",
)  # fmt: skip
CASE = ("model", "hidden", "seed", "without")


@dataclass
class Fewer:
    """Gates of which some are left out.

    Attributes:
        without: their names.
        parted: whether all gates would have judged a candidate in another way.
    """

    without: Collection[str]
    parted: bool = False

    def objection(self, j: Judged) -> Rejection | None:
        """As of :mod:`idapt_pl.diagnosis.rounds.gates`, of those that are left."""
        every = list(objections(j))
        some = [told for gate, told in every if gate.__name__ not in self.without]
        first, of_all = (next(iter(told), None) for told in (some, [t for _, t in every]))
        self.parted |= what_follows(first) != what_follows(of_all)
        return first


def what_follows(r: Rejection | None) -> object:
    """What a search does with a judgement: nothing of it depends on other reasons."""
    return r and (r.reason if r.reason in GO_ON_BY else "rejected")


@contextmanager
def judged_by(without: Collection[str]) -> Iterator[Fewer]:
    """Searches without these gates."""
    fewer = Fewer(without)
    with mock.patch.object(acceptance, "objection", fewer.objection):
        yield fewer


def run(model: str, count: int, seed: int, without: Collection[str]) -> dict:
    """Record, and diagnose once or twice."""
    drawn, spec, data, how = recorded(model, count, seed)

    def answer(left_out: Collection[str]) -> tuple[dict, bool]:
        started = time.perf_counter()
        with judged_by(left_out) as fewer:
            report = diagnose(spec, data, seed=seed).report
        effects = [e for e in report["effects"] if e["effect"] != "numerics"]
        missed, extra = matched(drawn.answers, effects)
        found = " + ".join(f"{e['effect']}({e['target']})" for e in effects)
        told = {
            "exact": int(not missed and not extra),
            "extra": extra,
            "found": found,
            "loss": report["error"]["after"],
        }
        return told | {"seconds": round(time.perf_counter() - started, 1)}, fewer.parted

    fewer, parted = answer(without)
    whole = answer(())[0] if parted else fewer
    return {
        "model": model, "hidden": count, "seed": seed, "recorded": how,
        "truth": truth_of(drawn), "without": " ".join(without), "parted": int(parted), **fewer,
        **{f"{k}_all": v for k, v in whole.items()}, "commit": git_commit(),
    }  # fmt: skip


def summarise(rows: list[dict]) -> str:
    """A Markdown table: one row a set of gates left out and way of recording."""
    lines = [
        "| without | recorded | cases | searches that parted | exact with all gates | without these | false effects "
        "with all | without these |",
        "|" + "---|" * 8,
    ]
    for without, how in sorted({(r["without"], r["recorded"]) for r in rows}):
        of = [r for r in rows if (r["without"], r["recorded"]) == (without, how)]
        told = (sum(int(r[k]) for r in of) for k in ("parted", "exact_all", "exact", "extra_all", "extra"))
        names = ", ".join(f"`{name}`" for name in without.split())
        lines.append(f"| {names} | {how} | {len(of)} | " + " | ".join(map(str, told)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=MODELS, choices=MODELS)
    p.add_argument("--counts", nargs="+", type=int, default=(0, 1, 2, 3), help="how many effects are hidden")
    p.add_argument("--seeds", nargs="+", type=int, default=[61])
    p.add_argument("--without", nargs="+", default=NEVER_ALONE, choices=[g.__name__ for g in GATES])
    p.add_argument("--summary", action="store_true", help="print the table of what is there, and run nothing")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "fewer_gates.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    done = {tuple(str(r[k]) for k in CASE) for r in rows}
    without = " ".join(o.without)
    cases = list(itertools.product(o.models, o.counts, o.seeds)) if not o.summary else []
    for model, count, seed in tqdm(cases, unit="case"):
        if (model, str(count), str(seed), without) not in done:
            rows.append(run(model, count, seed, o.without))
            write_rows(o.out, rows, FIELDS)
    print(summarise(rows))


if __name__ == "__main__":
    main()

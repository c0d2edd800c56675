"""What does each gate of the diagnosis keep out that nothing else would? One row a round in which one decides.

    python benchmarks/gates.py --seeds 60            # finished cases are kept
    python benchmarks/gates.py --summary             # the table of what is there

Controls and one to three effects, drawn as for benchmarks/several_effects.py; every second case is recorded poorly (see
benchmarks/reliability.py). In every round of the search all of ``idapt_pl/diagnosis/gates.py`` are asked about each
candidate. Then, for each gate, the round's choice is made again without it. A row says what was chosen, what would have
been, and whether these are hidden effects that were not found before. So it is about one round: what would come of a
wrong choice later, when choices are reopened and what became needless is left out, it does not tell.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import idapt_pl  # noqa: F401, I001  sets the GL backend before MuJoCo is loaded
import mujoco
from benchmarks.reliability import MODELS, poorly
from benchmarks.several_effects import Drawn, draw, truth_of
from benchmarks.tables import read_rows, write_rows
from benchmarks.undeclared.generate import generate
from tqdm import tqdm

from cli.provenance import git_commit
from datamodules import read_trajectories
from idapt_pl.diagnosis import acceptance, search
from idapt_pl.diagnosis.acceptance import accept
from idapt_pl.diagnosis.gates import GATES, Judged, objections
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.search_state import SearchState
from idapt_pl.diagnosis.trial import Rejection, Trial
from idapt_pl.effects.candidate import Candidate

FIELDS = (
    "model", "hidden", "seed", "recorded", "truth", "round", "gate", "chosen", "chosen_right", "instead",
    "instead_right", "seconds", "commit",
)  # fmt: skip
COUNTS = (0, 1, 2, 3)
NO_ROUND = "none"
"""A case in which no gate decided has one row with this for a gate, so that it is known to be done."""


@dataclass
class Watch:
    """Looks on while a search decides.

    Attributes:
        drawn: what is hidden.
        told: names of the gates that each candidate did not pass, by the candidate's identity and the round.
        rows: of the rounds in which a gate decided.
    """

    drawn: Drawn
    told: dict[tuple[int, int], list[str]] = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)

    def objection(self, j: Judged) -> Rejection | None:
        """As of :mod:`idapt_pl.diagnosis.gates`; all of them are noted."""
        every = list(objections(j))
        self.told[id(j.trial.candidate), j.trial.round] = [gate.__name__ for gate, _ in every]
        return every[0][1] if every else None

    def accept(self, state: SearchState, trials: Sequence[Trial]) -> tuple[SearchState | None, list[Trial]]:
        """As of :mod:`idapt_pl.diagnosis.acceptance`, and once more without each gate that alone keeps one out."""
        made = accept(state, trials)
        chosen = newest(made[0])
        for gate in GATES:
            alone = [gate.__name__]
            freed = [
                replace(t, rejection=None) if self.told.get((id(t.candidate), t.round)) == alone else t for t in trials
            ]
            instead = newest(accept(state, freed)[0])
            if instead is not chosen:
                self.rows.append({
                    "round": trials[0].round, "gate": gate.__name__,
                    "chosen": chosen.label if chosen else "", "chosen_right": self.is_right(state, chosen),
                    "instead": instead.label if instead else "", "instead_right": self.is_right(state, instead),
                })  # fmt: skip
        return made

    def is_right(self, state: SearchState, c: Candidate | None) -> int | str:
        """Whether it is a hidden effect that was not found before."""
        if c is None:
            return ""
        found = {(a.kind.name, a.target) for a in state.candidates}
        left = [set().union(*answers) for answers in self.drawn.answers]
        return int(any((c.kind.name, c.target) in answers for answers in left if not answers & found))


def newest(state: SearchState | None) -> Candidate | None:
    """What a round added."""
    return None if state is None else state.accepted[-1].candidate


@contextmanager
def watched(drawn: Drawn) -> Iterator[Watch]:
    """A search that is looked at."""
    watch = Watch(drawn)
    kept = acceptance.objection, search.accept
    acceptance.objection, search.accept = watch.objection, watch.accept
    try:
        yield watch
    finally:
        acceptance.objection, search.accept = kept


def hidden(model: str, count: int, seed: int) -> Drawn:
    """Effects of a world, none for a control."""
    drawn = draw(model, max(count, 1), seed)
    if count:
        return drawn
    nothing = replace(drawn.case, name=f"nothing_{model}", truth=(), parts=(), accept=(frozenset(),), kind="control")
    return Drawn(nothing, ())


def run(model: str, count: int, seed: int) -> list[dict]:
    """Record, diagnose and look on."""
    drawn, poor = hidden(model, count, seed), (MODELS.index(model) + count + seed) % 2 == 1
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(drawn.case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    started = time.perf_counter()
    with watched(drawn) as watch:
        diagnose(spec, poorly(data) if poor else data, seed=seed)
    common = {
        "model": model, "hidden": count, "seed": seed, "recorded": "poorly" if poor else "well",
        "truth": truth_of(drawn), "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip
    return [common | row for row in watch.rows] or [common | {"gate": NO_ROUND}]


def summarise(rows: list[dict]) -> str:
    """A Markdown table: for each gate, what it kept out in how many rounds."""
    cases = {(r["model"], r["hidden"], r["seed"]) for r in rows}
    lines = [
        f"{len(cases)} cases, {len({c for c in cases if str(c[1]) == '0'})} of them controls.",
        "",
        "| gate | kept a wrong effect out | of these in controls | kept a right one out | only changed which |",
        "|---|---|---|---|---|",
    ]
    for gate in GATES:
        of = [r for r in rows if r["gate"] == gate.__name__]
        wrong = [r for r in of if str(r["instead_right"]) == "0" and str(r["chosen_right"]) != "0"]
        right = [r for r in of if str(r["instead_right"]) == "1" and str(r["chosen_right"]) != "1"]
        controls = sum(str(r["hidden"]) == "0" for r in wrong)
        rest = len(of) - len(wrong) - len(right)
        lines.append(f"| `{gate.__name__}` | {len(wrong)} | {controls} | {len(right)} | {rest} |")
    return "\n".join(lines)


def main() -> None:
    """Run the cases that have no row yet and write the table."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--models", nargs="+", default=MODELS, choices=MODELS)
    p.add_argument("--counts", nargs="+", type=int, default=COUNTS, help="how many effects are hidden")
    p.add_argument("--seeds", nargs="+", type=int, default=[60])
    p.add_argument("--summary", action="store_true", help="print the table of what is there, and run nothing")
    p.add_argument("--out", type=Path, default=ROOT / "results" / "gates.csv")
    o = p.parse_args()
    rows = read_rows(o.out)
    done = {(r["model"], int(r["hidden"]), int(r["seed"])) for r in rows}
    todo = [k for k in itertools.product(o.models, o.counts, o.seeds) if k not in done and not o.summary]
    for key in tqdm(todo, unit="case"):
        rows += run(*key)
        write_rows(o.out, rows, FIELDS)
    print(summarise(rows))


if __name__ == "__main__":
    main()

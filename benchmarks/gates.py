"""Which gates of the diagnosis keep wrong effects out, and which of them are needed? One row a judged candidate.

    python benchmarks/gates.py --seeds 60            # finished cases are kept
    python benchmarks/gates.py --summary             # the tables of what is there

Controls and one to three effects, drawn as for benchmarks/several_effects.py; every second case is recorded poorly (see
benchmarks/reliability.py). In every round of a search all of ``idapt_pl/diagnosis/rounds/gates.py`` are asked about
each candidate that is judged on held-out episodes. ``right`` says whether it is a hidden effect that was not found
before, ``gates`` which it did not pass, ``chosen`` whether the round took it. The second table takes gates one after
the other until they keep out all wrong candidates of rounds that took nothing. It is about one round: what would come
of a wrong choice later, when choices are reopened and what became needless is left out, it does not tell.
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
from unittest import mock

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
from datamodules import Trajectories, read_trajectories
from idapt_pl.diagnosis import search
from idapt_pl.diagnosis.rounds import acceptance
from idapt_pl.diagnosis.rounds.acceptance import accept
from idapt_pl.diagnosis.rounds.gates import GATES, Judged, objections
from idapt_pl.diagnosis.search import diagnose
from idapt_pl.diagnosis.state.search_state import SearchState
from idapt_pl.diagnosis.candidates.trial import Rejection, Trial
from idapt_pl.effects.candidate import Candidate

FIELDS = (
    "model", "hidden", "seed", "recorded", "truth", "decision", "round", "candidate", "right", "gates", "chosen",
    "before", "after", "gain_error", "seconds", "commit",
)  # fmt: skip
COUNTS = (0, 1, 2, 3)


@dataclass
class Watch:
    """Looks on while a search decides.

    Attributes:
        drawn: what is hidden.
        told: names of the gates that each candidate did not pass, by the candidate's identity and its estimate.
        rows: of all candidates that were judged.
        decisions: rounds that it has seen; a search that begins anew counts its own from 0.
    """

    drawn: Drawn
    told: dict[tuple[int, bytes], list[str]] = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)
    decisions: int = 0

    def objection(self, j: Judged) -> Rejection | None:
        """As of :mod:`idapt_pl.diagnosis.rounds.gates`; all of them are noted."""
        every = list(objections(j))
        self.told[id(j.candidate), j.x.tobytes()] = [gate.__name__ for gate, _ in every]
        return every[0][1] if every else None

    def accept(self, state: SearchState, trials: Sequence[Trial]) -> tuple[SearchState | None, list[Trial]]:
        """As of :mod:`idapt_pl.diagnosis.rounds.acceptance`; who stood for choice is noted."""
        made = accept(state, trials)
        chosen, self.decisions = newest(made[0]), self.decisions + 1
        for t in trials:
            if t.losses is not None:
                self.rows.append({
                    "decision": self.decisions, "round": t.round, "candidate": t.candidate.label,
                    "right": self.is_right(state, t.candidate), "chosen": int(t.candidate is chosen),
                    "gates": " ".join(self.told[id(t.candidate), t.x[-1].tobytes()]),
                    "before": round(t.held_out + t.gain, 4),
                    "after": round(t.held_out, 4), "gain_error": round(t.gain_error, 5),
                })  # fmt: skip
        return made

    def is_right(self, state: SearchState, c: Candidate) -> int:
        """Whether it is a hidden effect that was not found before."""
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
    with (
        mock.patch.object(acceptance, "objection", watch.objection),
        mock.patch.object(search, "accept", watch.accept),
    ):
        yield watch


def hidden(model: str, count: int, seed: int) -> Drawn:
    """Effects of a world, none for a control."""
    drawn = draw(model, max(count, 1), seed)
    if count:
        return drawn
    nothing = replace(drawn.case, name=f"nothing_{model}", truth=(), parts=(), accept=(frozenset(),), kind="control")
    return Drawn(nothing, ())


def recorded(model: str, count: int, seed: int) -> tuple[Drawn, mujoco.MjSpec, Trajectories, str]:
    """What is hidden, the nominal model, its recordings, and how these were made: every second case poorly."""
    drawn, poor = hidden(model, count, seed), (MODELS.index(model) + count + seed) % 2 == 1
    with tempfile.TemporaryDirectory() as folder:
        nominal, measured = generate(drawn.case, seed, Path(folder))
        spec, data = mujoco.MjSpec.from_file(str(nominal)), read_trajectories(measured)
    return drawn, spec, poorly(data) if poor else data, "poorly" if poor else "well"


def run(model: str, count: int, seed: int) -> list[dict]:
    """Record, diagnose and look on."""
    drawn, spec, data, how = recorded(model, count, seed)
    started = time.perf_counter()
    with watched(drawn) as watch:
        diagnose(spec, data, seed=seed)
    common = {
        "model": model, "hidden": count, "seed": seed, "recorded": how,
        "truth": truth_of(drawn), "seconds": round(time.perf_counter() - started, 1), "commit": git_commit(),
    }  # fmt: skip
    return [common | row for row in watch.rows] or [common]


def objected(rows: list[dict]) -> list[tuple[set[str], bool]]:
    """Of each candidate that did not pass: the gates, and whether it is right."""
    return [(set(r["gates"].split()), str(r["right"]) == "1") for r in rows if r.get("gates")]


def last_rounds(rows: list[dict]) -> list[dict]:
    """Candidates of rounds that took nothing."""
    took = {(r["model"], r["hidden"], r["seed"], r.get("decision")) for r in rows if str(r.get("chosen")) == "1"}
    return [r for r in rows if (r["model"], r["hidden"], r["seed"], r.get("decision")) not in took]


def gate_names(rows: list[dict]) -> list[str]:
    """Of today's gates, and of those that rows of earlier versions name."""
    return list(
        dict.fromkeys([g.__name__ for g in GATES] + [name for r in rows for name in (r.get("gates") or "").split()])
    )


def sufficient(rows: list[dict]) -> list[tuple[str, int]]:
    """Gates, the most useful first, that together keep out all wrong candidates; with how many each adds."""
    left, found = [gates for gates, right in objected(rows) if not right], []
    while left:
        best = max(gate_names(rows), key=lambda name: sum(name in gates for gates in left))
        found.append((best, sum(best in gates for gates in left)))
        left = [gates for gates in left if best not in gates]
    return found


def summarise(rows: list[dict]) -> str:
    """Markdown tables: what each gate objects to, and which would do."""
    cases = {(r["model"], r["hidden"], r["seed"]) for r in rows}
    every, last = objected(rows), last_rounds(rows)
    lines = [
        f"{len(cases)} cases, {len({c for c in cases if str(c[1]) == '0'})} of them controls.",
        "",
        "| gate | wrong effects that it does not let pass | alone | right ones | alone |",
        "|---|---|---|---|---|",
    ]
    for gate in gate_names(rows):
        wrong, right = ([gates for gates, is_right in every if is_right == wanted] for wanted in (False, True))
        counts = (sum(gate in gates for gates in wrong), sum(gates == {gate} for gates in wrong),
                  sum(gate in gates for gates in right), sum(gates == {gate} for gates in right))  # fmt: skip
        lines.append(f"| `{gate}` | " + " | ".join(map(str, counts)) + " |")
    lines += ["", "| in rounds that took nothing these do | wrong effects that each adds |", "|---|---|"]
    return "\n".join(lines + [f"| `{name}` | {count} |" for name, count in sufficient(last)])


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

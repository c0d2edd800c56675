"""``idapt ledger``: every control step in the target, checked against the files that hold them.

A ledger that is missing or unreadable is restored. Where it disagrees with the files, each disagreement is a line and
the exit code is 1; --repair writes what the files hold.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from cli.arguments import parser
from idapt_pl.envs.ledger import training_interactions
from idapt_pl.run import Run
from idapt_pl.run_folder.interactions import disagreements, held_interactions

EXAMPLES = """examples:
  idapt ledger --run runs/inverted_pendulum_hard_0
  idapt ledger --run runs/inverted_pendulum_hard_0 --repair"""


def main(args: list[str]) -> int:
    """Run ``idapt ledger``."""
    p = parser("ledger", __doc__, EXAMPLES)
    p.add_argument("--run", type=Path, required=True, help="run folder, as `idapt fit` wrote it")
    p.add_argument("--repair", action="store_true", help="rewrite the ledger from the files")
    p.add_argument("--json", action="store_true", help="print JSON instead of a table")
    o = p.parse_args(args)
    run = Run.open(o.run)
    ledger, feeding = run.worlds.ledger, run.config.feeding
    if o.repair or ledger.damaged or not ledger.path.exists():
        run.restore_ledger()
    held, unreadable = held_interactions(run.folder, feeding.num_envs, feeding.warmup_steps)
    entries = ledger.entries
    wrong = [*unreadable, *([] if unreadable else disagreements(entries, held))]
    result = {"run": str(o.run), "training_total": training_interactions(entries), "entries": entries}
    print(json.dumps(result | {"disagreements": wrong}, indent=2) if o.json else ledger_table(entries))
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


def ledger_table(entries: list[dict]) -> str:
    """Control steps by step and purpose."""
    if not entries:
        return "no target interactions yet"
    rows = [(f"{e['step']}" if e["step"] >= 0 else "afterwards", e["purpose"], f"{e['count']:,}") for e in entries]
    rows = [("step", "purpose", "control steps"), *rows]
    rows += [("", "used by the method (training)", f"{training_interactions(entries):,}")]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(f"{a:<{widths[0]}}  {b:<{widths[1]}}  {c:>{widths[2]}}" for a, b, c in rows)

"""``idapt report``: the story of a run as one HTML page.

The page is made from what the run folder holds, finished or not; nothing is simulated and the target is left alone.
It shows the return in the target against target interactions (evaluation only), and for every grounding step what G
does to images, what F changes, which effects were found, whether the step was rolled back, and what it all cost.
``idapt fit`` writes the same page when it ends.
"""

from __future__ import annotations

from pathlib import Path

from cli.arguments import parser
from idapt_pl.report.run_page import write_run_report
from idapt_pl.run import Run

EXAMPLES = """examples:
  idapt report --run runs/inverted_pendulum_hard_0
  idapt report --run runs/inverted_pendulum_hard_0 --out /tmp/report.html"""


def main(args: list[str]) -> int:
    """Run ``idapt report``."""
    p = parser("report", __doc__, EXAMPLES)
    p.add_argument("--run", type=Path, required=True, help="run folder, as `idapt fit` wrote it")
    p.add_argument("--out", type=Path, help="file to write; RUN/report.html if left out")
    o = p.parse_args(args)
    if o.out is not None and o.out.exists() and o.out.suffix != ".html":
        raise ValueError(f"{o.out}: --out is there already and is no page; name an .html file")
    print(write_run_report(Run.open(o.run), o.out))
    return 0

"""The figure of a run: returns in the target against what they cost."""

from __future__ import annotations

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from idapt_pl.diagnosis.figures import AFTER, BEFORE, STYLE, svg
from idapt_pl.report.record import Record

ORACLE = "#2f7d3b"


def returns(record: Record, metric: str) -> str:
    """Target return of every step's policy against target interactions, as SVG; references are lines."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 3.4), layout="constrained")
        axis = figure.subplots()
        for name, result, colour in (
            ("oracle, trained in the target with its reward", record.oracle, ORACLE),
            ("direct transfer of the source policy", record.direct_transfer, BEFORE),
        ):
            if result:
                axis.axhline(result["mean"], color=colour, ls="--", lw=1.4, label=name)
        x = [s.interactions for s in record.evaluated]
        results = [s.evaluation["target"] for s in record.evaluated]
        y, spread = [r["mean"] for r in results], [r["std"] for r in results]
        label = f"this run (bars: spread over {len(results[0]['returns'])} episodes)"
        axis.errorbar(x, y, spread, color=AFTER, marker="o", ms=6, lw=1.8, capsize=4, label=label, zorder=3)
        for step, a, b in zip(record.evaluated, x, y, strict=True):
            name = "rolled back" if step.selection.get("rolled_back") else f"step {step.k}" if step.k else "G only"
            axis.annotate(name, (a, b), (9, 3), textcoords="offset points", ha="left", va="bottom", fontsize=9)
        axis.set_xlim(0, 1.12 * max(x))
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.1 * (high - low))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axis.set_xlabel("target interactions used for training (control steps)")
        axis.set_ylabel(f"{metric} in the target")
        figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=9)
        return svg(figure)

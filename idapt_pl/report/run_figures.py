"""The figures of a run: returns in the target against what they cost, and forecasts of what was read of it."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from idapt_pl.image_diagnosis.result import ForecastChannel, ForecastExample
from idapt_pl.report.plots import AFTER, BEFORE, MEASURED, REFERENCE, STYLE, escape_mathtext
from idapt_pl.report.run_record import RunRecord

SHOWN_CHANNELS = 4
"""Channels of a forecast, those that moved most for how far off it was."""


def returns_figure(record: RunRecord, metric: str) -> Figure:
    """Target return of every step's policy against target interactions; references are lines."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 3.4), layout="constrained")
        axis = figure.subplots()
        for name, result, colour in (
            ("oracle, trained in the target with its reward", record.oracle, REFERENCE),
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
        axis.set_xlim(0, 1.12 * max(*x, 1))
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.1 * (high - low))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axis.set_xlabel("target interactions used for training (control steps)")
        axis.set_ylabel(f"{metric} in the target")
        figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=9)
    return figure


def forecast_figure(example: ForecastExample) -> Figure:
    """One episode as read of the target, and ensembles that forecast it without and with effects; a panel a channel."""
    channels, changed = example.channels, any(c.before != c.after for c in example.channels.values())
    bands = {"before": "the source", "after": "with the effects"} if changed else {"before": "the source"}
    shown = worst_forecast_channels(channels)
    rows = math.ceil(len(shown) / 2)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 1.0 + 1.8 * rows), layout="constrained")
        axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
        for axis, name in zip(axes, shown, strict=False):
            c = channels[name]
            time = example.dt * np.arange(len(c.read))
            for (key, label), colour in zip(bands.items(), (BEFORE, AFTER), strict=False):
                band = getattr(c, key)
                axis.fill_between(time, band.low, band.high, color=colour, alpha=0.2, lw=0)
                axis.plot(time, band.mean, color=colour, lw=1.6, label=f"{label} (band: all of the ensemble)")
            axis.plot(time, c.read, ".", color=MEASURED, ms=4, label="read of the target")
            axis.set_title(f"{escape_mathtext(name)} ({c.unit})", loc="left", fontsize=10)
        for axis in axes[-2:]:
            axis.set_xlabel("time in the episode (s)")
        for axis in axes[len(shown) :]:
            axis.remove()
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=3, frameon=False, fontsize=9)
    return figure


def worst_forecast_channels(channels: dict[str, ForecastChannel]) -> list[str]:
    """Channels whose first forecast is furthest off for how much they move, in the model's order."""

    def relative_error(c: ForecastChannel) -> float:
        read = np.array(c.read)
        return float(np.square(read - c.before.mean).mean() / max(read.var(), 1e-12))

    keep = sorted(channels, key=lambda name: -relative_error(channels[name]))[:SHOWN_CHANNELS]
    return [name for name in channels if name in keep]

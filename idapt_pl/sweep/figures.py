"""The figures of a sweep: results by cell, scores with intervals, performance profiles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from idapt_pl.report.plots import BEFORE, REFERENCE, STYLE, escape_mathtext
from idapt_pl.sweep.results import RunResult
from idapt_pl.sweep.summaries import THRESHOLDS, Row

METHOD_COLOURS = ("#1f77b4", "#d1495b", "#2f7d3b", "#8e5ea2", "#c98b1a", "#4a4a4a", "#17a2a2", "#a55a3c")
"""Of the methods, in the order of the YAML."""

LINES = ("-", "--", ":", "-.")
"""Of their curves: the first for as many as there are colours, then the next."""

MOST_LEVEL = 4
"""Methods whose names stand beside each other below a panel; those of more are turned."""


def colour_of(methods: Sequence[str]) -> dict[str, str]:
    """A colour for each method."""
    return {m: METHOD_COLOURS[i % len(METHOD_COLOURS)] for i, m in enumerate(methods)}


def cells_figure(cells: Mapping[str, Sequence[RunResult]], paper: Mapping[str, float]) -> Figure:
    """A panel for each cell: every run's result, its direct transfer, and IDAPT in the paper.

    Args:
        cells: results by cell.
        paper: the paper's IDAPT by cell, where it has one.
    """
    methods = list(dict.fromkeys(r.run.method for mine in cells.values() for r in mine))
    colours, columns = colour_of(methods), min(3, len(cells))
    rows = math.ceil(len(cells) / columns)
    with matplotlib.rc_context(STYLE):
        height = 2.5 if len(methods) <= MOST_LEVEL else 3.2
        figure = Figure(figsize=(8.6, 0.6 + height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for axis, (cell, mine) in zip(axes, cells.items(), strict=False):
            for i, method in enumerate(methods):
                some = [r for r in mine if r.run.method == method and r.last is not None]
                spread = i + np.linspace(-0.15, 0.15, max(len(some), 1))[: len(some)] * (len(some) > 1)
                direct = [np.nan if r.direct_transfer is None else r.direct_transfer for r in some]
                axis.plot(spread, direct, "_", color="#8a8f98", ms=9, mew=1.6, zorder=2)
                axis.plot(spread, [r.last for r in some], "o", color=colours[method], ms=5.5, alpha=0.85, zorder=3)
            if cell in paper:
                axis.axhline(paper[cell], color=BEFORE, ls=":", lw=1.4)
            oracles = [r.oracle for r in mine if r.oracle is not None]
            if oracles:
                axis.axhline(float(np.mean(oracles)), color=REFERENCE, ls="--", lw=1.4)
            axis.set_title(escape_mathtext(cell), loc="left", fontsize=10)
            turned = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if len(methods) > MOST_LEVEL else {}
            axis.set_xticks(range(len(methods)), [escape_mathtext(m) for m in methods], fontsize=8.5, **turned)
            axis.set_xlim(-0.6, len(methods) - 0.4)
            axis.set_ylabel(mine[0].metric)
            axis.grid(axis="x", visible=False)
        for axis in axes[len(cells) :]:
            axis.remove()
    return figure


def scores_figure(overall: Sequence[Row]) -> Figure:
    """Interquartile mean, mean and optimality gap of each method with their intervals."""
    names = {"iqm": "interquartile mean", "mean": "mean", "optimality_gap": "optimality gap (less is better)"}
    methods = [row["method"] for row in overall]
    colours = colour_of(methods)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 1.0 + 0.42 * len(methods)), layout="constrained")
        for axis, (key, title) in zip(figure.subplots(1, 3, sharey=True), names.items(), strict=True):
            for y, row in enumerate(overall):
                if row[f"{key}_low"] is not None:
                    ends = [row[f"{key}_low"], row[f"{key}_high"]]
                    axis.plot(ends, [y, y], color=colours[row["method"]], lw=7, alpha=0.35, solid_capstyle="butt")
                axis.plot(row[key], y, "|", color=colours[row["method"]], ms=14, mew=2.4)
            axis.set_title(title, loc="left", fontsize=10)
            axis.set_yticks(range(len(methods)), [escape_mathtext(m) for m in methods])
            axis.set_ylim(len(methods) - 0.5, -0.5)
            axis.grid(axis="y", visible=False)
    return figure


def profiles_figure(profiles: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]], banded: bool) -> Figure:
    """Share of runs above each score, a curve a method; bands are pointwise 95 % intervals."""
    colours = colour_of(list(profiles))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 3.2), layout="constrained")
        axis = figure.subplots()
        for i, (method, (share, low, high)) in enumerate(profiles.items()):
            look = {"color": colours[method], "ls": LINES[i // len(METHOD_COLOURS) % len(LINES)], "lw": 1.8}
            axis.step(THRESHOLDS, share, where="post", label=escape_mathtext(method), **look)
            if banded:
                axis.fill_between(THRESHOLDS, low, high, step="post", color=colours[method], alpha=0.15, lw=0)
        axis.set_xlabel("score")
        axis.set_ylabel("share of runs above it")
        axis.set_ylim(-0.03, 1.05)
        figure.legend(loc="outside upper left", ncols=4, frameon=False, fontsize=9)
    return figure

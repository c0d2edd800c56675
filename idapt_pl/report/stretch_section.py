"""What was left out of a diagnosis, in words and on a time line."""

from __future__ import annotations

from html import escape

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.report.html import details, figure, paragraph, row, section, table
from idapt_pl.report.plots import BEFORE, MEASURED, NOISE, STYLE, svg
from idapt_pl.stretches.stretch import Stretch, StretchReport

MOST_LANES = 12
"""Episodes on the time line; those with something left out come first."""

SENTENCE_TIMES = 4
"""Stretches that a sentence names."""


def stretch_sentences(report: StretchReport | None) -> list[str]:
    """What was left out, as sentences; nothing where nothing was."""
    if report is None or not report.stretches:
        return []
    made, found = [], report.found
    if given := [s for s in report.stretches if not s.found]:
        by = f" ({'; '.join(report.conditions)})" if report.conditions else ""
        made.append(f"Left out as asked{by}: {seconds_of(given)} in {count_of(given)}.")
    if found:
        first = ", ".join(map(place_of, found[:SENTENCE_TIMES]))
        more = f" and {len(found) - SENTENCE_TIMES} more" if len(found) > SENTENCE_TIMES else ""
        made.append(
            f"Left out, as the model cannot hold there: {first}{more}. Forecasts fail far beyond the rest: a push, a "
            "contact that the model lacks, motors that are off? --keep-all keeps them in."
        )
        made.append(with_them_sentence(report))
    return made


def with_them_sentence(report: StretchReport) -> str:
    """What came out with the found stretches in."""
    names = ", ".join(phrase_at(e, t) for e, t in report.with_them) or "no effect"
    return f"With them in, the verdict was {report.verdict_with_them.replace('_', ' ')} ({names})."


def place_of(s: Stretch) -> str:
    """A stretch in words."""
    return f"episode {s.episode} from {s.begin:.2f} to {s.end:.2f} s"


def seconds_of(stretches: list[Stretch]) -> str:
    """How long stretches are together."""
    return f"{format_number(sum(s.end - s.begin for s in stretches))} s"


def count_of(stretches: list[Stretch]) -> str:
    """How many stretches."""
    return f"{len(stretches)} stretch{'es' * (len(stretches) != 1)}"


def stretch_section(report: StretchReport | None) -> str:
    """The section of the page; empty where nothing was left out."""
    if report is None or not report.stretches:
        return ""
    heads = ("episode", "#from, s", "#to, s", "why", "#error", "most in")
    rows = [row(*stretch_cells(s)) for s in report.stretches]
    caption = (
        "Error: of short forecasts, the median within the stretch, in units of what is usual in the rest of the "
        "recording (it takes 6). It is the model with the effects found that forecasts."
    )
    words = [paragraph(s) for s in stretch_sentences(report)]
    picture = figure(f'<div class="wide">{styled_timeline_figure(report)}</div>', timeline_caption(report))
    listed = table(heads, rows) + paragraph(caption, "small")
    listed = listed if len(rows) <= MOST_LANES else details(f"all {len(rows)} stretches", listed)
    share = paragraph(f"That is {100 * report.share:.2g} % of the recordings.")
    return section("Left out", *words, share, picture, listed)


def stretch_cells(s: Stretch) -> tuple[str, ...]:
    """A stretch as cells of the table."""
    why = "forecasts fail" if s.found else "as asked"
    error = "-" if s.error is None else format_number(s.error)
    return (f"{s.episode}", f"#{s.begin:.2f}", f"#{s.end:.2f}", why, f"#{error}", ", ".join(s.channels) or "-")


def timeline_caption(report: StretchReport) -> str:
    """What the time line shows."""
    shown, all_of_them = len(lanes_of(report)), len(report.lengths)
    some = "" if shown == all_of_them else f" {shown} of {all_of_them} episodes."
    return (
        "Every lane is an episode; the line is the error of short forecasts along it, on a logarithmic scale up to "
        f"100 times the usual. Red was found and left out, grey was left out as asked.{some}"
    )


def lanes_of(report: StretchReport) -> list[int]:
    """Episodes that the time line shows."""
    touched = {s.episode for s in report.stretches}
    order = sorted(range(len(report.lengths)), key=lambda e: (e not in touched, e))
    return sorted(order[:MOST_LANES])


def styled_timeline_figure(report: StretchReport) -> str:
    """The picture as SVG, in the style of all."""
    with matplotlib.rc_context(STYLE):
        return svg(timeline_figure(report))


def timeline_figure(report: StretchReport) -> Figure:
    """Episodes one above the other, errors along them, and what was left out."""
    lanes = lanes_of(report)
    made = Figure(figsize=(8.6, 0.7 + 0.42 * len(lanes)), layout="constrained")
    axes = made.subplots(len(lanes), 1, sharex=True, squeeze=False)[:, 0]
    for axis, e in zip(axes, lanes, strict=True):
        draw_lane(axis, report, e)
    axes[-1].set_xlabel("time in the episode (s)")
    axes[-1].tick_params(labelbottom=True)
    return made


def draw_lane(axis: Axes, report: StretchReport, episode: int) -> None:
    """One episode."""
    axis.plot([0, report.lengths[episode]], [0, 0], color=NOISE, lw=1)
    if report.errors and len(report.errors[episode].time):
        along = report.errors[episode]
        height = np.log10(np.clip(along.error, 1.0, 100.0)) / 2
        axis.fill_between(along.time, 0, height, color=MEASURED, alpha=0.75, lw=0)
    for s in (s for s in report.stretches if s.episode == episode):
        axis.axvspan(s.begin, s.end, color=BEFORE if s.found else NOISE, alpha=0.35, lw=0)
    axis.set_ylim(0, 1.05)
    axis.set_yticks([])
    axis.grid(False)
    axis.spines["left"].set_visible(False)
    axis.tick_params(labelbottom=False)
    axis.set_ylabel(escape(f"{episode}"), rotation=0, ha="right", va="center", fontsize=9)

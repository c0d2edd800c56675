"""Several recordings on the page of a diagnosis: values over files, and what changed."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from idapt_pl.diagnosis.answer.result import ParameterEstimate
from idapt_pl.effects.wording import format_estimate, format_number, phrase_at
from idapt_pl.recording_sets.result import ChangedValue, SetComparison, SetResult, SetValue
from idapt_pl.report.html import figure, paragraph, row, section, table
from idapt_pl.report.plots import AFTER, BEFORE, NOISE, STYLE, escape_mathtext, svg

COMMON_IS_WORSE = 1.3
"""Errors with the common answer, in those with a file's own values, from which the common answer is not enough."""


def name_of_value(value: SetValue, comparison: SetComparison) -> str:
    """A value in words: the effect, and the parameter where it has several."""
    effect, target, parameter = value
    several = sum(v[:2] == (effect, target) for v in comparison.comparable[0].values) > 1
    return phrase_at(effect, target) + (f" ({parameter})" if several else "")


def comparison_sentences(comparison: SetComparison) -> list[str]:
    """What differs between the files, as sentences."""
    compared = comparison.comparable
    made = [changed_sentence(c, comparison) for c in comparison.changed]
    if not made and compared[0].values and len(compared) > 1:
        made.append(f"None of the values found differs surely between the {len(compared)} files.")
    if not compared[0].values:
        made.append(
            f"No effect was found in all {len(comparison.sets)} files together, so there are no values to compare."
        )
    if short := [r.recordings.name for r in comparison.sets if not r.comparable]:
        made.append(f"Not compared, as no stretch that is used is as long as a forecast: {', '.join(short)}.")
    if told := common_is_worse(comparison):
        made.append(told)
    for r in comparison.sets:
        if r.recordings.name in comparison.unlike:
            made.append(
                f"In {r.recordings.name} an error of {format_number(r.own)} times {comparison.yardstick} is left, more "
                "than in the others: something else differs there; diagnose it alone."
            )
    return made


def common_is_worse(comparison: SetComparison) -> str:
    """That one value for all files leaves more than each file's own, where it does; else empty."""
    worst = max(comparison.comparable, key=lambda r: r.common / max(r.own, 1e-9))
    if worst.common < COMMON_IS_WORSE * worst.own or not comparison.changed:
        return ""
    return (
        f"One value for all files leaves {format_number(worst.common)} times {comparison.yardstick} in "
        f"{worst.recordings.name}, its own {format_number(worst.own)}: take each file's own values."
    )


def changed_sentence(c: ChangedValue, comparison: SetComparison) -> str:
    """One value that differs, from the first file to the last where these differ most."""
    by_file = {r.recordings.name: r.values[c.value] for r in comparison.comparable}
    order = [n for n in by_file if n in (c.lowest, c.highest)]
    told = [f"{value_in_words(by_file[n])} in {n}" for n in order]
    what = "rose" if order[0] == c.lowest else "fell"
    return f"{name_of_value(c.value, comparison)} {what} from {' to '.join(told)} ({c.sigmas:.0f} standard errors)."


def value_in_words(p: ParameterEstimate) -> str:
    """A value with its unit."""
    value, _ = format_estimate(p.estimate, p.ci95)
    return value + (f" {p.unit}" if p.unit not in ("", "1") else "")


def set_cells(r: SetResult, comparison: SetComparison) -> list[str]:
    """A file as cells: name, episodes, errors, values with their intervals."""
    episodes = r.recordings.episodes
    which = f"{episodes[0]} to {episodes[-1]}" if len(episodes) > 1 else f"{episodes[0]}"
    values = []
    for name in comparison.comparable[0].values:
        p = r.values.get(name)
        value, interval = format_estimate(p.estimate, p.ci95) if p else ("-", "")
        values.append(f"{value} ({interval})" if interval else value)
    return [r.recordings.name, which, *(format_number(x) for x in (r.before, r.common, r.own)), *values]


def set_heads(comparison: SetComparison) -> list[str]:
    """Heads of the table of files."""
    values = comparison.comparable[0].values
    named = [
        f"{name_of_value(v, comparison)}{f', {p.unit}' if p.unit not in ('', '1') else ''}" for v, p in values.items()
    ]
    return ["file", "episodes", "before", "common", "own", *named]


def comparison_section(comparison: SetComparison | None) -> str:
    """The section of the page; empty for a single file."""
    if comparison is None:
        return ""
    heads = set_heads(comparison)
    rows = [row(*(c if i < 2 else f"#{c}" for i, c in enumerate(set_cells(r, comparison)))) for r in comparison.sets]
    caption = (
        f"Errors in standard deviations of {comparison.yardstick}, on all episodes of a file: before, with the common "
        "answer, and with the same effects fitted to the file alone. Values are these own ones, with 95 % intervals."
    )
    parts = [*map(paragraph, comparison_sentences(comparison))]
    parts.append(table([h if i < 2 else f"#{h}" for i, h in enumerate(heads)], rows))
    parts.append(paragraph(caption, "small"))
    if comparison.comparable[0].values:
        drawn = f'<div class="wide">{styled_values_figure(comparison)}</div>'
        told = "Values by file, with 95 % intervals; the band is the common answer. Red: differs between files."
        parts.append(figure(drawn, told))
    return section("File by file", *parts)


def styled_values_figure(comparison: SetComparison) -> str:
    """The picture as SVG, in the style of all."""
    with matplotlib.rc_context(STYLE):
        return svg(values_figure(comparison))


def values_figure(comparison: SetComparison) -> Figure:
    """Every value over the files, and the common answer."""
    files = comparison.comparable
    values = list(files[0].values)
    common = {(*e.key, name): p for e in comparison.effects for name, p in e.parameters.items()}
    changed = {c.value for c in comparison.changed}
    columns = min(2, len(values))
    lines = -(-len(values) // columns)
    made = Figure(figsize=(8.6, 0.4 + 2.1 * lines), layout="constrained")
    axes = made.subplots(lines, columns, squeeze=False).ravel()
    at = np.arange(len(files))
    for axis, value in zip(axes, values, strict=False):
        own = [r.values[value] for r in files]
        x = np.array([float(p.estimate) for p in own])
        ends = np.array([p.ci95 or (p.estimate, p.estimate) for p in own], float)
        band = common[value].ci95
        if band is not None:
            axis.axhspan(*band, color=NOISE, alpha=0.5, lw=0)
        colour = BEFORE if value in changed else AFTER
        axis.errorbar(at, x, yerr=np.abs(ends.T - x), fmt="o", color=colour, capsize=3, ms=5)
        axis.set_xlim(-0.5, len(at) - 0.5)
        axis.set_xticks(at, [escape_mathtext(r.recordings.name) for r in files], fontsize=8)
        unit = f" ({own[0].unit})" if own[0].unit not in ("", "1") else ""
        axis.set_title(escape_mathtext(name_of_value(value, comparison) + unit), loc="left", fontsize=10)
    for axis in axes[len(values) :]:
        axis.set_visible(False)
    return made

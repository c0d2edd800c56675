"""The part of a diagnosis about effects that change while they are recorded, on the page and in the terminal."""

from __future__ import annotations

from html import escape

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from idapt_pl.diagnosis.answer.changes import ChangeFinding, ChangeReport
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.report.html import paragraph, section
from idapt_pl.report.plots import AFTER, MEASURED, STYLE, escape_mathtext, svg


def change_sentences(changes: ChangeReport | None) -> list[str]:
    """What changes, in words; nothing where nothing was tested or nothing does."""
    return [change_sentence(f) for f in changes.found] if changes is not None else []


def change_sentence(f: ChangeFinding) -> str:
    """One change."""
    first, last = format_number(f.first), format_number(f.last)
    unit = f" {f.unit}" if f.unit not in ("", "1") else ""
    at = format_number(f.at) if f.at is not None else ""
    how = {
        "drift_within": f"drifts in every episode, from {first} to {last}{unit}",
        "decay_within": f"settles in every episode, from {first} to {last}{unit}, with a time constant of {at} s",
        "step_within": f"steps in every episode at {at} s, from {first} to {last}{unit}",
        "drift_over": f"drifts from episode to episode, from {first} to {last}{unit}",
        "step_over": f"steps at {at} s of episode {f.episode}, from {first} to {last}{unit}",
    }[f.kind]
    chance = f"p = {f.p:.3f}" if f.p > 0.001 else "p ≤ 0.001"
    return (
        f"{phrase_at(f.effect, f.target)[0].upper()}{phrase_at(f.effect, f.target)[1:]} does not stay the same: its "
        f"{f.parameter} {how} ({chance}). That accounts for {100 * f.removed_share:.0f} % of what is left."
    )


def change_section(changes: ChangeReport | None) -> str:
    """Plots over time and words; a sentence where everything tested is constant; empty where nothing was tested."""
    if changes is None or not changes.tested:
        return ""
    title = "Does it change while it is recorded?"
    if not changes.found:
        return section(
            title, paragraph(f"No: of the parameters tested ({changes.tested}) none changes as far as can be seen.")
        )
    parts = []
    for f in changes.found:
        with matplotlib.rc_context(STYLE):
            picture = svg(change_figure(f))
        parts.append(paragraph(change_sentence(f)))
        caption = "Values in stretches of the recordings, with 95 % intervals, around the estimate for all of them."
        parts.append(f'<figure><div class="wide">{picture}</div><figcaption>{escape(caption)}</figcaption></figure>')
    return section(title, *parts)


def change_figure(f: ChangeFinding) -> Figure:
    """Values over time in the episode, or over episodes."""
    figure = Figure(figsize=(6.4, 2.4), layout="constrained")
    axis = figure.subplots()
    where, value, half = zip(*f.series, strict=True)
    axis.errorbar(where, value, half, fmt="o", color=MEASURED, ms=4, lw=1.2, capsize=2)
    ends = (min(where), max(where))
    if f.kind in ("step_within", "step_over"):
        step = float((f.at if f.kind == "step_within" else f.episode) or 0.0)
        axis.step((ends[0], step, ends[1]), (f.first, f.last, f.last), where="post", color=AFTER, lw=1.6)
    elif f.kind in ("drift_within", "drift_over"):
        axis.plot(ends, (f.first, f.last), color=AFTER, lw=1.6)
    elif f.kind == "decay_within" and f.at:
        time = np.linspace(*ends, 60)
        left = np.exp(-time / f.at)
        axis.plot(time, f.last + (f.first - f.last) * (left - left[-1]) / (left[0] - left[-1]), color=AFTER, lw=1.6)
    axis.set_xlabel("time in the episode (s)" if "within" in f.kind else "episode")
    unit = f" ({f.unit})" if f.unit not in ("", "1") else ""
    axis.set_title(escape_mathtext(f"{f.parameter} of {f.effect} at {f.target}{unit}"), loc="left", fontsize=10)
    return figure

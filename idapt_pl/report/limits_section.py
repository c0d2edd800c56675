"""How small a change these recordings would have shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idapt_pl.diagnosis.answer.detection_limits import DetectionLimit
from idapt_pl.effects.wording import format_number, phrase_at
from idapt_pl.report.html import details, paragraph, row, section, table

SHOWN_LIMITS = 12
"""Rows that are not folded away."""


def limits_section(limits: Sequence[DetectionLimit]) -> str:
    """A table of usual effects that were not found; nothing where no limits were computed."""
    if not limits:
        return ""
    heads = ("effect", "#in the model", "#seen from a change of", "unit")
    rows = [row(phrase_at(x.effect, x.target), f"#{format_number(x.nominal)}", *size_cells(x)) for x in limits]
    parts = [table(heads, rows[:SHOWN_LIMITS])]
    if len(rows) > SHOWN_LIMITS:
        parts.append(details(f"{len(rows) - SHOWN_LIMITS} more", table(heads, rows[SHOWN_LIMITS:])))
    caption = (
        "Usual effects that were not found, one at a time, beside what was found: about the smallest change that these "
        "recordings would have shown. Smaller ones may be there. To see them, record more, longer or larger motion."
    )
    return section("What would have been seen", *parts, paragraph(caption, "small"))


def size_cells(x: DetectionLimit) -> tuple[str, str]:
    """The smallest change that is seen, and its unit."""
    if not np.isfinite(x.change):
        return "#none is seen", ""
    if x.told_as_share:
        return f"#{format_number(100 * x.change / abs(x.nominal), 2)}", "%"
    return f"#{format_number(x.change, 2)}", "" if x.unit == "1" else x.unit


def limit_sentence(limits: Sequence[DetectionLimit]) -> str:
    """Of each usual effect the smallest change that would have been seen where it shows worst; empty without limits."""
    told, groups = [], dict[tuple[str, str], list[DetectionLimit]]()
    for x in limits:
        groups.setdefault((x.effect, "%" if x.told_as_share else x.unit), []).append(x)
    for of in groups.values():
        worst = max(of, key=lambda x: x.change / (abs(x.nominal) if x.told_as_share else 1.0))
        if np.isfinite(worst.change):
            size = " ".join(size_cells(worst)).removeprefix("#").strip()
            told.append(f"{phrase_at(worst.effect, worst.target)}, {size}{' (elsewhere less)' * (len(of) > 1)}")
    return f"Alone, each of these would have been seen from about this change on: {'; '.join(told)}." if told else ""

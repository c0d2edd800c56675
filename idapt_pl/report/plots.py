"""One style for all figures: fonts, colours, and how a figure becomes part of a page."""

from __future__ import annotations

import io
import re

import matplotlib
from matplotlib.figure import Figure

MEASURED, BEFORE, AFTER, NOISE, REFERENCE = "#222222", "#d1495b", "#1f77b4", "#b5b5b5", "#2f7d3b"
"""Colours of what was measured, of a model as it was and with what was found, of noise, and of a reference."""

STYLE = {
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e8e8e8",
    "axes.axisbelow": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "idapt",
}
"""Matplotlib's settings, for ``matplotlib.rc_context``."""


def escape_mathtext(name: str) -> str:
    """A name that matplotlib does not take for a formula."""
    return name.replace("$", r"\$")


def svg(figure: Figure) -> str:
    """A figure as an inline SVG element that scales with the page, the same each time."""
    buffer = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Type": None, "Format": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    head, rest = text.split(">", 1)
    return re.sub(r' (width|height)="[^"]*"', "", head) + ">" + rest

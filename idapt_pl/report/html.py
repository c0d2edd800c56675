"""The HTML of all reports: sections, tables, figures; no scripts, nothing fetched."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: #222; background: #f4f5f7;
       margin: 0; }
main { max-width: 56rem; margin: 0 auto; padding: 1rem; }
section, header { background: #fff; border: 1px solid #e3e5e8; border-radius: 10px; padding: 1rem 1.25rem;
                  margin: 0 0 1rem; }
header { border-left: 6px solid var(--tone); }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .5rem; color: var(--tone); }
h2 { font-size: 1.1rem; margin: 0 0 .5rem; }
p { margin: 0 0 .6rem; }
p:last-child { margin-bottom: 0; }
.lead { font-size: 1.1rem; }
.small, figcaption { color: #62666d; font-size: .87rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .93rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .75rem .35rem 0; border-bottom: 1px solid #eceef0; }
th { font-weight: 600; color: #62666d; }
.named td:first-child { min-width: 11rem; }
.wide + p, figcaption { margin-top: .5rem; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.accepted td { background: #eef7ee; }
tr.round td { color: #62666d; font-weight: 600; padding-top: .9rem; }
figure { margin: 0; }
figure svg { width: 100%; min-width: 30rem; height: auto; display: block; }
pre { font: .82rem/1.45 ui-monospace, Menlo, Consolas, monospace; margin: 0; }
pre span { display: block; white-space: pre; }
.add { background: #e6f4e6; } .cut { background: #fbe9e9; } .at { color: #8a8f98; }
code { font: .9em ui-monospace, Menlo, Consolas, monospace; }
details { margin-top: .5rem; } summary { cursor: pointer; color: #35597e; }
"""


def section(title: str, *parts: str) -> str:
    """One box of the page."""
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table that scrolls sideways where it does not fit; heads that start with ``#`` are of numbers."""
    kind = ' class="named"' if head[0] else ""
    titles = "".join(
        f'<th class="n">{escape(h[1:])}</th>' if h.startswith("#") else f"<th>{escape(h)}</th>" for h in head
    )
    return f'<div class="wide"><table{kind}>\n<tr>{titles}</tr>\n' + "\n".join(rows) + "\n</table></div>"


def row(*cells: str, kind: str = "") -> str:
    """A row of cells; those that start with ``#`` are numbers."""
    made = "".join(
        f'<td class="n">{escape(c[1:])}</td>' if c.startswith("#") else f"<td>{escape(c)}</td>" for c in cells
    )
    return f'<tr class="{kind}">{made}</tr>' if kind else f"<tr>{made}</tr>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"

"""The HTML of all pages: skeleton, sections, tables, pictures; no scripts, nothing fetched.

Titles, names, captions, cells and texts are plain text, which is escaped here; parts and contents are HTML that
functions of this module made.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import imageio.v3 as iio
import numpy as np

TONE = "#1d6fa5"
"""Colour of the headline of pages that give no verdict."""

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
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
td.n { white-space: nowrap; }
tr.accepted td { background: #eef7ee; }
tr.round td { color: #62666d; font-weight: 600; padding-top: .9rem; }
figure { margin: 0; }
figure svg { width: 100%; min-width: 30rem; height: auto; display: block; }
pre { font: .82rem/1.45 ui-monospace, Menlo, Consolas, monospace; margin: 0; }
pre span { display: block; white-space: pre; }
.add { background: #e6f4e6; } .cut { background: #fbe9e9; } .at { color: #8a8f98; }
code { font: .9em ui-monospace, Menlo, Consolas, monospace; }
details { margin-top: .5rem; } summary { cursor: pointer; color: #35597e; }
.tiles { display: flex; flex-wrap: wrap; gap: .6rem; margin: .8rem 0; }
.tile { flex: 1 1 8rem; background: #f4f5f7; border-radius: 8px; padding: .5rem .75rem; }
.tile b { display: block; font-size: 1.35rem; font-variant-numeric: tabular-nums; }
.tile.best { background: #e6f1f8; }
.pictures { display: flex; flex-wrap: wrap; gap: 1.25rem; margin: .6rem 0; }
img { image-rendering: pixelated; border-radius: 4px; display: block; }
.grid { display: grid; gap: 4px; align-content: start; align-items: center; font-size: .87rem; color: #62666d; }
.grid img { width: 100%; }
.clip { width: 276px; } .clip img { width: 100%; }
"""


def document(title: str, parts: Iterable[str], tone: str, css: str = "") -> str:
    """A whole page.

    Args:
        title: of the browser's tab, plain text.
        parts: HTML of the header and the sections; empty ones are left out.
        tone: colour of the headline, as in CSS.
        css: rules of this page alone.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{CSS}:root {{ --tone: {tone}; }}\n{css}</style>\n"
        f"</head>\n<body>\n<main>\n{joined(parts)}\n</main>\n</body>\n</html>\n"
    )


def joined(parts: Iterable[str]) -> str:
    """Pieces of HTML one below the other, without empty ones."""
    return "\n".join(p for p in parts if p)


def header(title: str, *parts: str, note: str = "") -> str:
    """The box on top, with the headline; ``note`` is small and stands above it."""
    above = f"{paragraph(note, 'small')}\n" if note else ""
    return f"<header>\n{above}<h1>{escape(title)}</h1>\n{joined(parts)}\n</header>"


def section(title: str, *parts: str, kind: str = "") -> str:
    """One box of the page; empty parts are left out."""
    return f"<section{css_class(kind)}>\n<h2>{escape(title)}</h2>\n{joined(parts)}\n</section>"


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table that scrolls sideways where it does not fit; heads that start with ``#`` are of numbers."""
    titles = "".join(
        f'<th class="n">{escape(h[1:])}</th>' if h.startswith("#") else f"<th>{escape(h)}</th>" for h in head
    )
    kind = css_class("named" if head[0] else "")
    return scrollable(f"<table{kind}>\n<tr>{titles}</tr>\n" + "\n".join(rows) + "\n</table>")


class Markup(str):
    """HTML that a function of this module made, for a cell: it is not escaped again."""

    @classmethod
    def of(cls, text: str) -> Markup:
        """Plain text, escaped."""
        return cls(escape(text))

    def __add__(self, other: str) -> Markup:
        return Markup(str(self) + (other if isinstance(other, Markup) else escape(other)))


def link(text: str, anchor: str) -> Markup:
    """Text that leads to a place on the same page."""
    return Markup(f'<a href="#{anchor}">{escape(text)}</a>')


def row(*cells: str, kind: str = "") -> str:
    """A row of cells; those that start with ``#`` are numbers, those that are :class:`Markup` are HTML."""

    def cell(c: str) -> str:
        if isinstance(c, Markup):
            return f"<td>{c}</td>"
        return f'<td class="n">{escape(c[1:])}</td>' if c.startswith("#") else f"<td>{escape(c)}</td>"

    made = "".join(map(cell, cells))
    return f"<tr{css_class(kind)}>{made}</tr>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f"<p{css_class(kind)}>{escape(text)}</p>"


def details(summary: str, *parts: str) -> str:
    """What is folded away until the reader asks for it; empty parts are left out."""
    return f"<details><summary>{escape(summary)}</summary>\n{joined(parts)}</details>"


def preformatted(text: str) -> str:
    """Plain text in a fixed-width font, line breaks as they are."""
    return f"<pre>{escape(text)}</pre>"


def scrollable(content: str) -> str:
    """HTML that scrolls sideways where it does not fit."""
    return f'<div class="wide">{content}</div>'


def figure(content: str, caption: str, kind: str = "") -> str:
    """A picture, as HTML, with a caption in plain text below it."""
    return f"<figure{css_class(kind)}>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def image(uri: str, alt: str) -> str:
    """An image with what it shows in words."""
    return f'<img src="{uri}" alt="{escape(alt)}">'


def picture_row(*parts: str) -> str:
    """Pictures beside each other, as far as they fit; empty parts are left out."""
    return f'<div class="pictures">{"".join(p for p in parts if p)}</div>'


def picture_grid(rows: Mapping[str, Sequence[str]], width: int) -> str:
    """Rows of images, each with its name before it.

    Args:
        rows: name to the images' URIs, as many in each row.
        width: of an image, pixels.
    """
    columns = max(map(len, rows.values()))
    cells = "".join(
        f"<span>{escape(name)}</span>" + "".join(image(uri, name) for uri in uris) for name, uris in rows.items()
    )
    style = f"grid-template-columns: 6.5rem repeat({columns}, {width}px)"
    return f'<div class="grid" style="{style}">{cells}</div>'


def tiles(*made: str) -> str:
    """Headline numbers beside each other, as :func:`tile` makes them."""
    return f'<div class="tiles">{"".join(made)}</div>'


def tile(value: str, name: str, kind: str = "") -> str:
    """A headline number and what it is of."""
    return f'<div class="{" ".join(filter(None, ("tile", kind)))}"><b>{escape(value)}</b>{escape(name)}</div>'


def png_uri(pixels: np.ndarray) -> str:
    """An image, uint8 (H, W, 3), as the data URI of a PNG."""
    return data_uri(iio.imwrite("<bytes>", pixels, extension=".png"), "png")


def data_uri(data: bytes, kind: str) -> str:
    """An image file as a data URI, so that the page needs nothing beside it; ``kind`` is png or gif."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def css_class(kind: str) -> str:
    """The attribute of a tag that says which rules apply to it; empty if there is none."""
    return f' class="{kind}"' if kind else ""

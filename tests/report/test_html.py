"""The HTML kit: plain text is escaped, empty parts leave nothing behind, a page needs nothing beside it."""

from html.parser import HTMLParser

import numpy as np

from idapt_pl.report import html

VOID = {"meta", "img"}


class Balanced(HTMLParser):
    """Fails on a tag that is closed out of turn."""

    def __init__(self, text):
        super().__init__()
        self.open, self.data = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.data.append(data)


HOSTILE = '<script src="x">&'


def test_a_page_of_all_parts_is_balanced_and_shows_text_as_it_is():
    uri = html.png_uri(np.zeros((2, 2, 3), np.uint8))
    parts = [
        html.header(HOSTILE, html.tiles(html.tile(HOSTILE, HOSTILE, "best")), note=HOSTILE),
        html.section(
            HOSTILE,
            html.paragraph(HOSTILE, "small"),
            html.table(("", HOSTILE, "#n"), [html.row(HOSTILE, HOSTILE, "#1", kind="accepted")]),
            html.picture_row(html.figure(html.scrollable(html.image(uri, HOSTILE)), HOSTILE)),
            html.picture_grid({HOSTILE: [uri, uri]}, 92),
            html.details(HOSTILE, html.preformatted(HOSTILE)),
        ),
    ]
    page = html.document(HOSTILE, parts, html.TONE)
    assert Balanced(page).data.count(HOSTILE) == 14, "every place where text can stand"
    assert "<script" not in page and f"--tone: {html.TONE}" in page


def test_empty_parts_leave_nothing_behind():
    assert html.section("a", "", html.paragraph("b"), "") == html.section("a", html.paragraph("b"))
    assert html.document("a", ["", "<p>b</p>", ""], "red") == html.document("a", ["<p>b</p>"], "red")
    assert html.row("a") == "<tr><td>a</td></tr>", "no empty attribute"


def test_cells_that_start_with_a_hash_are_numbers():
    assert html.row("a", "#1.5") == '<tr><td>a</td><td class="n">1.5</td></tr>'
    assert '<th class="n">value</th>' in html.table(("what", "#value"), [])

"""Figures in prose are those of the tables that they name."""

import re

import pytest

from benchmarks.figures import FIGURE, TABLE, differing, filled_in, pages, value_of

PAGES = pages()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_figures_in_prose_are_those_of_their_tables(page):
    text = page.read_text(encoding="utf-8")
    assert [*differing(text)] == [], "python benchmarks/figures.py fills them in"
    assert len(re.findall(r"<!--results/", text)) == len(FIGURE.findall(text)), "a mark that cannot be read"
    assert len(re.findall(r"<!--tables:", text)) == len(TABLE.findall(text)), "a table without its end"


def test_there_are_figures_to_compare():
    assert sum(len(FIGURE.findall(page.read_text(encoding="utf-8"))) for page in PAGES) >= 20


@pytest.fixture
def root(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results/t.csv").write_text("method,seed,mean,minutes\nno F,0,12.4,3\nno F,1,20,5\nIDAPT,0,99.6,\n")
    return tmp_path


def test_a_figure_is_found_and_a_wrong_one_is_seen(root):
    text = "It has <!--results/t.csv:mean:method=no+F&seed=0:.0f-->13<!--/--> here."
    assert [*differing(text, root)] == [("results/t.csv:mean:method=no+F&seed=0:.0f", "13", "12")]
    mended = filled_in(text, root)
    assert mended == text.replace(">13<", ">12<") and not [*differing(mended, root)]


def test_a_table_is_written_between_its_marks(root):
    (root / "results/bounds.csv").write_text("task,domain,policy,metric,mean\nwalker2d,hard,oracle,return,10\n")
    (root / "results/walker_hard.csv").write_text(
        "task,run,method,seed,grounding_step,mean,target_interactions\nwalker2d,IDAPT,visual only,0,0,2,8000\n"
    )
    text = "Before.\n\n<!--tables:hard-->\n\nold\n\n<!--/tables-->\n\nAfter."
    ((where, stands, should),) = differing(text, root)
    assert (where, stands) == ("table hard", "old") and should.endswith(
        "| `walker_hard`, return | 1 | 8,000 |  | 2 |  | 10 | 1930 |"
    )
    assert filled_in(text, root) == text.replace("old", should)


@pytest.mark.parametrize(
    ("column", "rows", "shape", "value"),
    [("sum(minutes)/2", "", ".1f", "4.0"), ("mean(mean)", "method=no+F", ".1f", "16.2"),
     ("count(mean)", "", ".0f", "3"), ("min(mean)", "", ".1f", "12.4"), ("mean", "method=IDAPT", ".0f", "100")],
)  # fmt: skip
def test_figures_of_several_rows(column, rows, shape, value, root):
    assert value_of("results/t.csv", column, rows, shape, root) == value


@pytest.mark.parametrize(
    ("column", "rows", "words"),
    [("mean", "method=no+F", "2 rows"), ("mean", "method=x", "0 rows"), ("meen", "", "no column meen"),
     ("mean", "metod=x", "no column metod"), ("sum(mean)", "method=x", "no row"), ("best(mean)", "", "best")],
)  # fmt: skip
def test_marks_that_mean_nothing_are_named(column, rows, words, root):
    with pytest.raises(ValueError, match=words):
        value_of("results/t.csv", column, rows, ".0f", root)

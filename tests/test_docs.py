"""The pages: short where they must be, links that lead somewhere, figures that have a table behind them."""

import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]
DECISIONS = sorted((DOCS / "decisions").glob("[0-9]*.md"))
PROSE = [ROOT / "README.md", DOCS / "index.md", *sorted(DOCS.glob("guide/*.md")), *sorted(DOCS.glob("reference/*.md"))]
FENCE = re.compile(r"^ *(```|~~~).*?^ *\1[^\n]*$", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
HEADING = re.compile(r"^#{1,6} +(.+?)\s*$", re.MULTILINE)
RESULT = re.compile(r"\bresults/[\w*]+\.\w+")
README_WORDS, DECISION_WORDS, SENTENCE_WORDS = 700, 250, 25


def name(path: Path) -> str:
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def without_code(text: str) -> str:
    """A page without what is shown as code and without comments."""
    return re.sub(r"`+[^`\n]*`+", "`code`", FENCE.sub("", COMMENT.sub("", text)))


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    found: set[str] = set()
    for heading in HEADING.findall(FENCE.sub("", text)):
        words = re.sub(r"\]\([^)]*\)", "", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", words).strip().replace(" ", "-")
        number = next(n for n in range(99) if (f"{slug}-{n}" if n else slug) not in found)
        found.add(f"{slug}-{number}" if number else slug)
    return found


def broken_links(page: Path) -> list[str]:
    """Relative links and pictures of a page that lead nowhere."""
    broken = []
    for url in LINK.findall(without_code(page.read_text(encoding="utf-8"))):
        if re.match(r"[a-z][a-z0-9+.-]*:", url):
            continue
        file, _, anchor = url.partition("#")
        target = (page.parent / file).resolve() if file else page
        missing = anchor and target.suffix == ".md" and target.is_file() and anchor not in anchors(target.read_text())
        if not target.exists() or missing:
            broken.append(url)
    return broken


def sentences(text: str) -> list[str]:
    """The sentences of a page: no code, tables, headings; a list's item or a paragraph ends one."""
    text = LINK.sub(lambda m: re.sub(r"^!?\[|\]\(.*$", "", m[0], flags=re.DOTALL), without_code(text))
    blocks: list[str] = [""]
    for line in text.splitlines():
        line = line.strip()
        if not line or line.startswith(("#", "|", ":::", "---")):
            blocks.append("")
        elif re.match(r"([-*+]|\d+\.|>) ", line):
            blocks.append(line.split(" ", 1)[1])
        else:
            blocks[-1] += " " + line
    parts = [s for block in blocks for s in re.split(r"(?<=[.!?])[\"*)_]* +(?=\S)", block)]
    return [s for s in parts if re.search(r"\w", s)]


def mean_words(text: str) -> float:
    """Words in a sentence, on average."""
    found = sentences(text)
    return sum(len(s.split()) for s in found) / max(len(found), 1)


def keys(config: dict) -> set[str]:
    """Names of all keys of a config."""
    return {k for key, value in config.items() for k in ({key} | (keys(value) if isinstance(value, dict) else set()))}


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= README_WORDS


@pytest.mark.parametrize(
    ("page", "names"),
    [("README.md", ["hard"]), ("docs/reference/results.md", ["hard", "quick", "easy", "kept", "own"]),
     ("docs/reference/results_runs.md", ["pendulum", "cheetah", "walker", "fetch", "sawyer"])],
)  # fmt: skip
def test_pages_have_the_tables_of_results(page, names):
    """What stands in them is compared by tests/benchmarks/test_figures.py."""
    assert re.findall(r"<!--tables:(\w+)-->", (ROOT / page).read_text()) == names


@pytest.mark.parametrize("page", DECISIONS, ids=name)
def test_decisions_are_short(page):
    assert len(page.read_text().split()) <= DECISION_WORDS


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    assert not broken_links(page)


@pytest.mark.parametrize("page", PROSE, ids=name)
def test_sentences_are_short(page):
    assert mean_words(page.read_text()) <= SENTENCE_WORDS


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_tables_behind_the_figures_exist(page):
    missing = [n for n in RESULT.findall(page.read_text()) if not any(ROOT.glob(n))]
    assert not missing


def test_the_site_builds_and_all_its_links_lead_somewhere(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command[1:])}:\n{done.stdout}{done.stderr}"
    api = (tmp_path / "site/reference/api/index.html").read_text(encoding="utf-8")
    assert "idapt_pl.run.Run" in api and "idapt_pl.diagnosis.search.diagnose" in api, "docstrings are in it"


def test_every_page_is_in_the_site():
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())

    def pages(entries: list) -> set[str]:
        values = [v for entry in entries for v in entry.values()]
        return {p for v in values for p in ({v} if isinstance(v, str) else pages(v))}

    there = {str(p.relative_to(DOCS)) for folder in ("guide", "reference") for p in DOCS.glob(f"{folder}/*.md")}
    assert pages(site["nav"]) == there | {"index.md", "log/index.md", "decisions/README.md"}
    logged = (DOCS / "log" / "index.md").read_text()
    assert all(f"]({p.name})" in logged for p in DOCS.glob("log/2*.md"))


def test_every_key_of_the_configs_is_explained():
    page = (DOCS / "reference" / "configs.md").read_text()
    told = {part for code in re.findall(r"`([^`\n]+)`", page) for part in re.split(r"[. ]+", code) if part}
    used = set().union(*(keys(yaml.safe_load(p.read_text())) for p in sorted((ROOT / "configs").glob("*.yaml"))))
    assert not {k for k in used if not any(fnmatch(k, t) for t in told - {"*"})}


def test_faults_are_found(tmp_path):
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    other.write_text("# A heading\n\n```\n# no heading\n```\n\n## `code` and *words*, twice\n\n## A heading\n")
    page.write_text(
        "[fine](other.md) [fine](other.md#a-heading) [fine](other.md#a-heading-1) [fine](https://example.org/x)\n"
        "[fine](other.md#code-and-words-twice) ![gone](gone.png) [gone](other.md#no-heading) [gone](#nowhere)\n"
        "`[code](nowhere.md)` [over\ntwo lines](gone.md)\n\n```\n[code](nowhere.md)\n```\n"
    )
    assert broken_links(page) == ["gone.png", "other.md#no-heading", "#nowhere", "gone.md"]
    assert mean_words("One two three. Four five?\n\n| a | table |\n\n- an item\n- another [long link](x.md)\n") == 2.5
    assert mean_words("word " * 40 + ".") > SENTENCE_WORDS
    assert RESULT.findall("see `results/gone.csv` and results/*_quick.csv") == [
        "results/gone.csv",
        "results/*_quick.csv",
    ]

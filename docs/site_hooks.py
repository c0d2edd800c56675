"""Hooks of mkdocs: pages link to files of the repository as GitHub shows them, and the site has its own way.

Tables and figures in ``results/`` are copied into the site. Links to other files (code, configs) become plain text, or
links to the repository where ``repo_url`` is set in mkdocs.yml.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

LINK = re.compile(r"(!?)\[([^\[\]]*(?:\[[^\]]*\][^\[\]]*)*)\]\(((?:\.\./)+[^)\s]+)\)")
ROOT = Path(__file__).parents[1]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Copy the tables and figures of ``results/``."""
    for path in sorted((ROOT / "results").iterdir()):
        files.append(File.generated(config, f"results/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite links that leave ``docs/``."""
    here = posixpath.dirname(page.file.src_uri)

    def rewritten(match: re.Match) -> str:
        picture, text, url = match.groups()
        target = posixpath.normpath(posixpath.join("docs", here, url))
        if target.startswith("docs/"):
            return match[0]
        if target.startswith("results/"):
            return f"{picture}[{text}]({posixpath.relpath(target, here or '.')})"
        if config.repo_url:
            return f"[{text}]({config.repo_url.rstrip('/')}/blob/main/{target})"
        return text

    return LINK.sub(rewritten, markdown)

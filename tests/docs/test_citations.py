"""Pages of docs that the source cites exist, and the code cites no page that readers do not have."""

import re

from .documented import ROOT

FOLDERS = ("toolkit", "closed_loop", "datasets", "sft_recipes", "tests", "docs")
SUFFIXES = {".py", ".yaml", ".md", ".toml"}
CITED = re.compile(r"\bdocs/[\w/]+\.md\b")


def cited_pages():
    """Files of the repository and the pages that each cites."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in SUFFIXES:
                yield path, set(CITED.findall(path.read_text(encoding="utf-8")))


def test_every_page_that_is_cited_exists():
    missing = {
        f"{path.relative_to(ROOT)}: {page}"
        for path, pages in cited_pages()
        for page in pages
        if not (ROOT / page).is_file()
    }
    assert not missing


def test_every_page_about_a_format_is_cited_by_the_source():
    cited = {page for path, pages in cited_pages() if path.suffix in (".py", ".yaml") for page in pages}
    assert {f"docs/formats/{path.name}" for path in (ROOT / "docs" / "formats").glob("*.md")} <= cited

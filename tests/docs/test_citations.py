"""Pages of docs that the source cites exist, and so do the modules that pages name."""

import re

import pytest

from .documented import PAGES, ROOT, SOURCE_FOLDERS

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


@pytest.mark.parametrize("page", [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES])
def test_every_module_that_a_page_names_exists(page):
    files = {
        f"/{path.relative_to(ROOT)}" for folder in (*SOURCE_FOLDERS, "tests") for path in (ROOT / folder).rglob("*")
    }
    named = re.findall(r"`([\w/]+\.py)`", page.read_text(encoding="utf-8"))
    assert not [name for name in named if not any(path.endswith(f"/{name}") for path in files)]
    packages = re.findall(r"`(olt_\w+(?:\.[a-z_]\w*)+)`", page.read_text(encoding="utf-8"))
    assert not [name for name in packages if not is_module_or_name(name, files)]


def is_module_or_name(dotted, files):
    """Whether a dotted path is a package, a module, or something that a module's text defines."""
    path = "/" + dotted.replace(".", "/")
    if any(file.endswith((f"{path}.py", path)) for file in files):
        return True
    module, _, name = dotted.rpartition(".")
    end = "/" + module.replace(".", "/")
    owners = [file for file in files if file.endswith((f"{end}.py", f"{end}/__init__.py"))]
    return any(re.search(rf"^(def |class )?{name}\b", (ROOT / file[1:]).read_text(), re.MULTILINE) for file in owners)

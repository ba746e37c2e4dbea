"""Every command and every piece of Python that README and docs show is run, or at least exists."""

import pytest

from .documented import PAGES, ROOT, SOURCE_FOLDERS, commands_named, commands_shown, find_fault, read_fences

LANGUAGES = {"sh", "python", "yaml", "toml", "csv", "text"}
SHOWN = [pytest.param(page, id=str(page.relative_to(ROOT))) for page in PAGES]
RUNS = [
    pytest.param(page, id=str(page.relative_to(ROOT)))
    for page in PAGES
    if any(fence.language in ("sh", "python") and fence.title is None for fence in read_fences(page))
]
SLOW = [case for case in RUNS if any(fence.mark == "slow" for fence in read_fences(case.values[0]))]


@pytest.mark.parametrize("page", SHOWN)
def test_every_command_that_is_shown_exists(page):
    faults = {shown: find_fault(shown) for shown in commands_shown(page)}
    assert not {shown: fault for shown, fault in faults.items() if fault}


@pytest.mark.parametrize("page", SHOWN)
def test_every_block_has_a_language(page):
    assert {fence.language for fence in read_fences(page)} <= LANGUAGES


@pytest.mark.parametrize("page", RUNS)
def test_what_is_shown_runs(page, page_folder):
    for fence in read_fences(page):
        if fence.mark is None:
            page_folder.carry_out(fence)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW)
def test_what_is_shown_runs_with_what_takes_long(page, page_folder):
    for fence in read_fences(page):
        if fence.mark in (None, "slow"):
            page_folder.carry_out(fence)


def test_commands_that_the_source_names_exist():
    faults = {
        f"{path.relative_to(ROOT)}: {shown}": find_fault(shown)
        for folder in SOURCE_FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        for shown in commands_named(path.read_text(encoding="utf-8"))
    }
    assert not {shown: fault for shown, fault in faults.items() if fault}


def test_faults_are_found():
    for shown in (
        "olt clip biuld",
        "olt clip build --ot STORE",
        "olt mix compose|shwo",
        "olt bench vehicel",
        "olt demo2",
    ):
        assert find_fault(shown), shown

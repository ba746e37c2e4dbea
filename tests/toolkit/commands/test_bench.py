"""`olt bench`: benchmarks by name, with and without options of their own."""

import json
from importlib.metadata import entry_points

import pytest

from olt_toolkit.bench.runner import benchmark_names
from olt_toolkit.runtime import command_line


def test_the_list_names_all_benchmarks(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.run(["bench", "list"]) == 0
    named = capsys.readouterr().out.split()
    with_own_options = {entry.name for entry in entry_points(group="olt.benchmark_commands")}
    assert set(named) == {*benchmark_names(), *with_own_options} and named == sorted(named)
    assert command_line.run(["bench", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"benchmarks": named}


def test_a_benchmark_has_its_own_options_or_the_common_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.run(["bench", "motion", "--help"]) == 0
    own = capsys.readouterr().out
    assert "--recording" in own and "--repeats" not in own
    assert command_line.run(["bench", "plucker", "--help"]) == 0
    assert "--repeats" in capsys.readouterr().out
    assert command_line.run(["bench", "plucker", "--recording", "x"]) == 2


def test_an_unknown_benchmark_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.run(["bench", "vehicel"]) == 1
    assert "no benchmark 'vehicel'" in capsys.readouterr().err

import ast
import inspect
import subprocess
import sys

import pytest

import olt_datasets


def test_every_name_that_is_declared_is_loaded_when_it_is_asked_for():
    tree = ast.parse(inspect.getsource(olt_datasets))
    declared = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    names = declared - {"lazy_names", "TYPE_CHECKING"}
    assert names <= set(dir(olt_datasets))
    for name in names:
        assert getattr(olt_datasets, name).__module__.startswith("olt_datasets.")
    with pytest.raises(AttributeError, match="has no attribute 'compose'"):
        olt_datasets.compose  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    heavy = {"torch", "polars", "pandas", "matplotlib", "numpy"}
    code = f"import sys, olt_datasets; print(sorted({heavy!r} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"

import ast
import importlib.util
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "tools" / "mutants.py"
SOURCE = """
@register(limit=1)
def clip(value: float, top: float = 2.0) -> float:
    if value < 0 and full:
        raise ValueError(1 + 1)
    return min(-value, top - 3)
"""


@pytest.fixture(scope="module")
def mutants():
    spec = importlib.util.spec_from_file_location("mutants", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_fault_is_put_in_once_and_alone(mutants):
    counter = mutants.Mutator()
    assert ast.unparse(counter.visit(ast.parse(SOURCE))) == ast.unparse(ast.parse(SOURCE))
    changes = []
    for number in range(counter.count):
        mutator = mutants.Mutator(number)
        assert ast.unparse(mutator.visit(ast.parse(SOURCE))) != ast.unparse(ast.parse(SOURCE))
        changes.append(mutator.change)
    assert sorted(changes) == [
        "3: 2.0  ->  3.0",
        "4: 0  ->  1",
        "4: value < 0  ->  value <= 0",
        "4: value < 0  ->  value >= 0",
        "4: value < 0 and full  ->  value < 0 or full",
        "6: -value  ->  value",
        "6: 3  ->  4",
        "6: min  ->  max",
        "6: top - 3  ->  top + 3",
    ]


def test_the_modules_and_tests_that_are_named_exist(mutants):
    for module, tests in mutants.CONFIGURATION["modules"].items():
        assert all((SCRIPT.parents[1] / file).exists() for file in (module, *tests)), module

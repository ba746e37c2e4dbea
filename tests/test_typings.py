"""Stubs that pyright reads in place of large packages tell of nothing that the packages have not."""

import ast
import inspect
from importlib import import_module
from pathlib import Path

import pytest

TYPINGS = Path(__file__).resolve().parents[1] / "typings"
STUBS = {
    ".".join(path.relative_to(TYPINGS).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(TYPINGS.rglob("*.pyi"))
    if path.stat().st_size
}


def assert_takes(function, stub):
    """A function takes the parameters that its stub names; `**config` stands for whichever they are."""
    parameters = inspect.signature(function).parameters.values()
    if any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters):
        return
    told = [each.arg for each in (*stub.args.args, *stub.args.kwonlyargs) if each.arg not in ("self", "cls")]
    assert set(told) <= {each.name for each in parameters}, f"{function} does not take {told}"


def assert_has(kind, name):
    """A class has an attribute, or sets one of that name on its instances."""
    package = kind.__module__.partition(".")[0]
    ours = [base for base in kind.__mro__ if base.__module__.partition(".")[0] == package]
    assert hasattr(kind, name) or any(name in inspect.getsource(base) for base in ours), f"{kind} has no {name}"


@pytest.mark.slow
@pytest.mark.parametrize("name", STUBS)
def test_a_stub_tells_what_is_there(name):
    pytest.importorskip(name.partition(".")[0], reason="the learned engine's packages are not installed")
    module = import_module(name)
    for stub in ast.parse(STUBS[name].read_text()).body:
        if isinstance(stub, ast.FunctionDef):
            assert_takes(getattr(module, stub.name), stub)
        if not isinstance(stub, ast.ClassDef):
            continue
        kind = getattr(module, stub.name)
        for member in stub.body:
            if isinstance(member, ast.FunctionDef):
                assert_takes(kind if member.name == "__init__" else getattr(kind, member.name), member)
            elif isinstance(member, ast.AnnAssign):
                assert_has(kind, member.target.id)
            elif isinstance(member, ast.Assign):
                assert_has(kind, member.targets[0].id)

"""Mutation run: small faults are put into numerically important modules one at a time, and tests must notice them.

python tools/mutants.py [MODULE.py ...] [--limit N] [--workers N]

`[tool.mutants]` of pyproject.toml names the modules and the tests that guard each. A mutant lives in a forked
process only: no file is changed. If a module has more mutants than the limit, the same ones are run every time.
"""

import argparse
import ast
import importlib
import os
import random
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

CONFIGURATION = tomllib.loads(Path("pyproject.toml").read_text())["tool"]["mutants"]
LIBRARIES = ("numpy", "scipy.optimize", "pandas", "polars", "pyarrow", "torch", "casadi", "cv2", "hypothesis", "pytest")
NEGATIONS = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
BOUNDARIES = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
OPERATORS |= {ast.Pow: ast.Mult, ast.Mod: ast.Add, ast.And: ast.Or, ast.Or: ast.And}
PAIRS = ("min max", "floor ceil", "sin cos", "any all", "minimum maximum", "argmin argmax", "left right")
TWINS = dict(pair for names in map(str.split, PAIRS) for pair in (names, names[::-1]))


def alternatives(node: ast.AST) -> Iterator[ast.AST]:
    """The faults that an expression can have."""
    match node:
        case ast.Compare(left, [operator], others):
            for table in (NEGATIONS, BOUNDARIES):
                if type(operator) in table:
                    yield ast.Compare(left, [table[type(operator)]()], others)
        case ast.BinOp(left, operator, right) if type(operator) in OPERATORS:
            yield ast.BinOp(left, OPERATORS[type(operator)](), right)
        case ast.BoolOp(operator, values):
            yield ast.BoolOp(OPERATORS[type(operator)](), values)
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield operand
        case ast.Constant(bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(float(value)):
            yield ast.Constant(1.5 * value + (value == 0.0))
        case ast.Name(name) if name in TWINS:
            yield ast.Name(TWINS[name], ast.Load())
        case ast.Attribute(value, name) if name in TWINS:
            yield ast.Attribute(value, TWINS[name], ast.Load())


class Mutator(ast.NodeTransformer):
    """Counts the faults that a module can have, and puts in the one whose number is asked for."""

    def __init__(self, chosen: int | None = None) -> None:
        self.chosen, self.count, self.change = chosen, 0, ""

    def visit(self, node: ast.AST) -> ast.AST:
        """Visit what computes: neither messages nor annotations nor decorators."""
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.arg) or getattr(node, "arg", None) == "strict":
            return node
        kept = {
            name: getattr(node, name) for name in ("annotation", "returns", "decorator_list") if hasattr(node, name)
        }
        for name, value in kept.items():
            setattr(node, name, [] if isinstance(value, list) else None)
        node = self.generic_visit(node)
        for name, value in kept.items():
            setattr(node, name, value)
        for other in alternatives(node):
            if self.count == self.chosen:
                self.change = f"{node.lineno}: {ast.unparse(node)}  ->  {ast.unparse(other)}"
                node = ast.copy_location(other, node)
            self.count += 1
        return node


def start(path: Path, tree: ast.AST, tests: list[str]) -> int:
    """Run the tests on a mutant in a process of its own, which ends with 0 where they pass; returns its number."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    status = 1
    try:
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = tempfile.mkdtemp()
        parts = path.with_suffix("").parts
        package = next(index for index, part in enumerate(parts) if part.startswith("olt_"))
        parent, module = importlib.import_module(".".join(parts[package:-1])), ModuleType(".".join(parts[package:]))
        module.__file__ = str(path)
        sys.modules[module.__name__] = module
        setattr(parent, parts[-1], module)
        exec(compile(ast.fix_missing_locations(tree), path, "exec"), module.__dict__)
        import pytest

        status = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", "--hypothesis-seed=0", *tests])
    finally:
        os._exit(int(status != 0))


def run(path: Path, tests: list[str], limit: int, workers: int) -> tuple[int, int, list[str]]:
    """Number of possible mutants, of those run, and the changes that no test noticed."""
    source = path.read_text()
    counter = Mutator()
    counter.visit(ast.parse(source))
    begun = time.monotonic()
    if os.waitpid(start(path, ast.parse(source), tests), 0)[1]:
        sys.exit(f"{path}: its tests fail without any change: {' '.join(tests)}")
    patience = 20.0 + 5.0 * (time.monotonic() - begun)
    waiting = list(range(counter.count))
    random.Random(path.name).shuffle(waiting)
    waiting = waiting[:limit]
    count, running, survivors = len(waiting), {}, []
    while waiting or running:
        while waiting and len(running) < workers:
            mutator = Mutator(waiting.pop())
            tree = mutator.visit(ast.parse(source))
            running[start(path, tree, tests)] = (mutator.change, time.monotonic())
        time.sleep(0.02)
        for child, (change, started) in list(running.items()):
            if time.monotonic() - started > patience:
                os.killpg(child, signal.SIGKILL)
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                del running[child]
                survivors += [change] if status == 0 else []
    return counter.count, count, sorted(survivors, key=lambda change: int(change.partition(":")[0]))


def main() -> None:
    """Run the modules that are asked for, or all, and print how many mutants were killed, and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("modules", nargs="*", default=list(CONFIGURATION["modules"]))
    parser.add_argument("--limit", type=int, default=CONFIGURATION["limit"], help="mutants of a module at most")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "POLARS_MAX_THREADS"), "1")
    for library in LIBRARIES:  # loaded once, for all forks
        importlib.import_module(library)
    for name in options.modules:
        begun = time.monotonic()
        possible, count, survivors = run(Path(name), CONFIGURATION["modules"][name], options.limit, options.workers)
        killed, seconds = count - len(survivors), time.monotonic() - begun
        print(f"{name}: {killed} of {count} mutants killed ({possible} possible), {seconds:.0f} s", flush=True)
        for change in survivors:
            print(f"    {change}", flush=True)


if __name__ == "__main__":
    main()

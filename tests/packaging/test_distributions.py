"""What is shipped: two distributions that share no file and declare what they import."""

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest

import olt_generator
import olt_toolkit

ROOT = Path(__file__).parents[2]
ENGINE, TOOLKIT = ROOT / "toolkit/generator", ROOT
PACKAGES = {
    ENGINE: ["toolkit/generator/olt_generator"],
    TOOLKIT: [
        "toolkit/olt_toolkit",
        "closed_loop/olt_closed_loop",
        "datasets/olt_datasets",
        "sft_recipes/olt_sft_recipes",
    ],
}
both = pytest.mark.parametrize("project", [ENGINE, TOOLKIT], ids=["engine", "toolkit"])


def sources(project: Path) -> list[Path]:
    return [path for folder in PACKAGES[project] for path in sorted((ROOT / folder).rglob("*.py"))]


def imported(project: Path) -> set[str]:
    """Top-level names of everything outside the standard library that a project imports anywhere, lazily included."""
    names = set()
    for path in sources(project):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add((node.module or "").partition(".")[0])
    own = {Path(folder).name for folder in PACKAGES[project]}
    return names - set(sys.stdlib_module_names) - own


def declared(project: Path, *, development: bool = False) -> set[str]:
    """Names of the distributions that a project requires, those of its extras included."""
    table = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    extras = table.get("optional-dependencies", {})
    required = [*table["dependencies"], *(line for name in extras if name != "dev" for line in extras[name])]
    return {canonical(re.match(r"[\w.-]+", line)[0]) for line in required}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def distributions_of(name: str) -> set[str]:
    found = ["olt-generator"] if name == "olt_generator" else packages_distributions().get(name, [])
    return {canonical(distribution) for distribution in found}


@both
def test_what_is_imported_is_declared(project):
    undeclared = {name for name in imported(project) if not distributions_of(name) & declared(project)}
    assert not undeclared


@both
def test_what_is_declared_is_imported(project):
    serving = {found for name in imported(project) for found in distributions_of(name)}
    assert not declared(project) - serving


def test_the_version_stands_in_one_place():
    versions = {olt_generator.__version__, olt_toolkit.__version__, version("olt-generator"), version("openlongtail")}
    assert len(versions) == 1


@pytest.fixture(scope="module")
def wheels(tmp_path_factory) -> dict[Path, list[str]]:
    """The names in the wheel of each project."""
    names = {}
    for project in PACKAGES:
        out = tmp_path_factory.mktemp("wheel")
        subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", out], cwd=project, check=True)
        with zipfile.ZipFile(next(out.glob("*.whl"))) as wheel:
            names[project] = wheel.namelist()
    return names


def test_each_package_is_owned_by_one_wheel(wheels):
    tops = {project: {name.partition("/")[0] for name in names} for project, names in wheels.items()}
    for project, folders in PACKAGES.items():
        packages = {Path(folder).name for folder in folders}
        assert {name for name in tops[project] if not name.endswith(".dist-info")} == packages


@both
def test_a_wheel_holds_every_file_of_its_packages(wheels, project):
    for folder in PACKAGES[project]:
        parent = (ROOT / folder).parent
        files = [path for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
        missing = {path.relative_to(parent).as_posix() for path in files} - set(wheels[project])
        assert not missing
        assert f"{Path(folder).name}/py.typed" in wheels[project]

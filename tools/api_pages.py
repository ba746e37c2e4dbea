"""Pages of the documentation site that list what each package gives its users: a hook of mkdocs.

A page shows the names of the package's `__init__`, with their signatures and docstrings, and below them every module
with the first line of its docstring. So the site follows the code without a list to keep.
"""

import ast
import sys
import typing
from importlib import import_module
from pathlib import Path
from types import ModuleType

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "olt_generator": "toolkit/generator",
    "olt_toolkit": "toolkit",
    "olt_closed_loop": "closed_loop",
    "olt_datasets": "datasets",
    "olt_sft_recipes": "sft_recipes",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add one page for each package."""
    for name, folder in PACKAGES.items():
        page = write_page(name, ROOT / folder / name)
        files.append(File.generated(config, f"api/{name}.md", content=page))
    return files


def write_page(name: str, folder: Path) -> str:
    """The page of one package as Markdown."""
    sys.path.insert(0, str(folder.parent))
    package = import_module(name)
    lines = [f"# {name}", "", package.__doc__ or "", "", "## Names", ""]
    for public in sorted(public_names(package), key=str.lower):
        lines += [f"::: {find_definition(package, public)}", ""]
    lines += ["## Modules", "", "| module | what |", "| --- | --- |"]
    for path in sorted(folder.rglob("*.py")):
        if path.name not in ("__init__.py", "__main__.py"):
            module = ".".join(path.relative_to(folder).with_suffix("").parts)
            lines.append(f"| `{module}` | {first_line(path)} |")
    return "\n".join(lines) + "\n"


def public_names(package: ModuleType) -> list[str]:
    """The names that the package gives its users, in its own code or when they are first asked for."""
    names = getattr(package, "__all__", [name for name in dir(package) if name[0] != "_" and name not in vars(typing)])
    return [name for name in names if getattr(getattr(package, name), "__module__", package.__name__)[:4] == "olt_"]


def find_definition(package: ModuleType, name: str) -> str:
    """Where a public name of the package is defined, as a dotted path; values are looked for by their own name."""
    value = getattr(package, name)
    module = getattr(value, "__module__", None)
    if module is None or not hasattr(value, "__qualname__"):
        return f"{package.__name__}.{name}"
    return f"{module}.{value.__qualname__}"


def first_line(path: Path) -> str:
    """First line of a module's docstring, fit for a cell of a table."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0].replace("|", "\\|")

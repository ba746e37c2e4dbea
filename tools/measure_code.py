"""Sizes of the source, as JSON: what a refactoring is held against. Run from the root of a checkout."""

import ast
import json
import statistics
from collections import Counter
from pathlib import Path

import grimp
import networkx

PACKAGES = {
    "olt_generator": "toolkit/generator",
    "olt_toolkit": "toolkit",
    "olt_closed_loop": "closed_loop",
    "olt_datasets": "datasets",
    "olt_sft_recipes": "sft_recipes",
}


def measure(root: Path) -> dict[str, object]:
    """Lines, files, functions, helpers called once, data classes and import cycles of the five packages."""
    files = [path for package, folder in PACKAGES.items() for path in (root / folder / package).rglob("*.py")]
    texts = {path: path.read_text() for path in files}
    lengths, once, data_classes = [], 0, 0
    for text in texts.values():
        nodes = list(ast.walk(ast.parse(text)))
        uses = Counter(node.id for node in nodes if isinstance(node, ast.Name))
        uses += Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))
        functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        lengths += [node.end_lineno - node.lineno + 1 for node in functions if node.end_lineno]
        private = [node.name for node in functions if node.name.startswith("_") and not node.name.startswith("__")]
        once += sum(uses[name] == 1 for name in private)
        data_classes += sum(
            any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)
            for node in nodes
            if isinstance(node, ast.ClassDef)
        )
    lengths.sort()
    return {
        "lines": sum(len(text.splitlines()) for text in texts.values()),
        "files": len(files),
        "functions": len(lengths),
        "function_lines_median": statistics.median(lengths),
        "function_lines_p95": lengths[int(0.95 * len(lengths))],
        "helpers_called_once": once,
        "helpers_called_once_percent": round(100 * once / len(lengths), 1),
        "data_classes": data_classes,
        "import_cycles": find_cycles(),
    }


def find_cycles() -> list[list[str]]:
    """Groups of modules that import each other, imports within functions and for type checking included."""
    graph = grimp.build_graph(*PACKAGES)
    imports = networkx.DiGraph(
        (module, target) for module in graph.modules for target in graph.find_modules_directly_imported_by(module)
    )
    return [sorted(group) for group in networkx.strongly_connected_components(imports) if len(group) > 1]


if __name__ == "__main__":
    print(json.dumps(measure(Path.cwd()), indent=2))

"""Are the versions of the environment that would run the recipe those that it pins?

The environment is that of an interpreter, which is asked for the metadata of its packages; nothing of them is imported.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distributions, requires
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.profiles import PROFILES, STAGE1_FIX, Recipe
from olt_sft_recipes.preflight.rows import Row, RowMaker

ROWS = RowMaker("versions")
_SECONDS = 20
_FLASH = "flash-attn"
# Printed by the interpreter that is asked: versions by name, and where each of some packages would be imported from.
_QUESTION = """
import importlib.metadata, importlib.util, json, sys
versions = {d.metadata["Name"]: d.version for d in importlib.metadata.distributions() if d.metadata["Name"]}
found = {}
for name in sys.argv[1:]:
    spec = importlib.util.find_spec(name)
    found[name] = None if spec is None else (spec.origin or next(iter(spec.submodule_search_locations), None))
print(json.dumps({"python": ".".join(map(str, sys.version_info[:3])), "versions": versions, "found": found}))
"""


def version_rows(plan: PreflightPlan, attention: str) -> list[Row]:
    """Rows of the environment of `plan.python`; `attention` is the `attn_implementation` of the checkpoint."""
    recipe = PROFILES[plan.policy].recipe
    if recipe is None:
        return [ROWS.not_checked("pins", "--python", f"{plan.policy} has no public SFT recipe, so nothing is pinned")]
    if plan.python is None:
        why = "no interpreter was given"
        return [ROWS.not_checked("pins", "--python", why, "give that of the recipe's environment with --python")]
    try:
        answer = _ask(plan.python, recipe.package, "alpamayo", "alpamayo_r1")
    except InputError as error:
        return [ROWS.failed("interpreter", plan.python, str(error), "give the python of the recipe's environment")]
    return [
        _python_row(plan.python, answer["python"], recipe.python),
        _pin_row(plan.python, answer["versions"], recipe, attention),
        *_package_rows(plan.python, answer["found"], recipe),
    ]


def own_version_rows() -> list[Row]:
    """Rows of this environment, which trains the toy, against what this project needs."""
    versions = {each.metadata["Name"]: each.version for each in distributions() if each.metadata["Name"]}
    pins = {}
    for line in requires("openlongtail") or ():
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            pins[requirement.name] = str(requirement.specifier)
    wrong, installed = _compare(versions, pins)
    good = f"{installed} of {len(pins)} packages as openlongtail needs them"
    return [ROWS.judge("pins", sys.executable, wrong, good, "install the project again")]


def _ask(python: Path, *modules: str) -> dict[str, Any]:
    try:
        done = subprocess.run(
            [str(python), "-c", _QUESTION, *modules], capture_output=True, timeout=_SECONDS, check=True, text=True
        )
        answer = json.loads(done.stdout.splitlines()[-1])
    except FileNotFoundError as error:
        raise InputError(f"{python}: no such interpreter") from error
    except subprocess.TimeoutExpired as error:
        raise InputError(f"{python}: gave no answer within {_SECONDS} s") from error
    except subprocess.CalledProcessError as error:
        said = (error.stderr.strip().splitlines() or ["nothing"])[-1]
        raise InputError(f"{python}: could not tell its packages ({said:.200})") from error
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"{python}: is no Python interpreter ({error})") from error
    return answer


def _python_row(python: Path, found: str, wanted: str) -> Row:
    wrong = [] if Version(found) in SpecifierSet(wanted) else [f"Python {found}, the recipe needs {wanted}"]
    return ROWS.judge(
        "python", python, wrong, f"Python {found}", "make the environment with `uv sync` in the recipe's folder"
    )


def _pin_row(python: Path, versions: dict[str, str], recipe: Recipe, attention: str) -> Row:
    pins = dict(recipe.pins)
    if attention != "flash_attention_2":
        del pins[_FLASH]
    wrong, installed = _compare(versions, pins)
    if any(each.startswith(_FLASH) for each in wrong):
        wrong.append('or set attn_implementation to "sdpa" in the checkpoint\'s config.json')
    left_out = "" if _FLASH in pins else f"; {_FLASH} is not needed for {attention}"
    good = f"{installed} of {len(pins)} packages as {recipe.package} pins them{left_out}"
    return ROWS.judge("pins", python, wrong, good, "run `uv sync` in the recipe's folder, in that environment")


def _compare(versions: dict[str, str], pins: dict[str, str]) -> tuple[list[str], int]:
    """What is not as it is pinned, and how many packages are."""
    by_name = {canonicalize_name(name): version for name, version in versions.items()}
    wrong = []
    for name, pin in pins.items():
        found = by_name.get(canonicalize_name(name))
        if found is None:
            wrong.append(f"{name} is absent, {pin or 'any version'} is needed")
        elif not _matches(found, pin):
            wrong.append(f"{name} is {found}, {pin} is needed")
    return wrong, len(pins) - len(wrong)


def _matches(found: str, pin: str) -> bool:
    """A build for a certain CUDA (`2.8.0+cu128`) counts as its version."""
    try:
        return SpecifierSet(pin).contains(Version(found), prereleases=True)
    except InvalidVersion:
        return False


def _package_rows(python: Path, found: dict[str, str | None], recipe: Recipe) -> Iterator[Row]:
    missing = [f"{name} cannot be imported" for name, where in found.items() if where is None]
    good = f"{', '.join(found)} can be found"
    action = "install the recipe editable (`uv sync` in its folder); start from its parent folder"
    yield ROWS.judge("recipe", python, missing, good, action)
    where = found[recipe.package]
    if where is not None:
        yield _fix_row(Path(where).parent)


def _fix_row(folder: Path) -> Row:
    """Whether the recipe holds the commit that made Stage 2 load what Stage 1 wrote."""
    check = "stage 1 loading fix"
    try:
        told = subprocess.run(
            ["git", "-C", str(folder), "merge-base", "--is-ancestor", STAGE1_FIX, "HEAD"],
            capture_output=True,
            timeout=_SECONDS,
            check=False,
        ).returncode
    except (OSError, subprocess.TimeoutExpired):
        told = None
    if told == 0:
        return ROWS.passed(check, folder, f"its history holds {STAGE1_FIX} (2026-07-07)")
    if told == 1:
        found = f"its history lacks {STAGE1_FIX} (2026-07-07): Stage 2 would train on the base model without a word"
        return ROWS.failed(check, folder, found, "update alpamayo-recipes")
    why = f"git does not know {STAGE1_FIX} there"
    return ROWS.not_checked(check, folder, why, "compare a tensor of Stage 2's language model with Stage 1's")

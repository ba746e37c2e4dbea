"""Reminders of the licences that a training touches; they judge nothing."""

from collections.abc import Iterator

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.profiles import PROFILES
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_toolkit.runtime.json_files import read_json

ROWS = RowMaker("licence")
EXPORT_SUMMARY = "export.json"
_LARGEST = 64 << 20


def licence_rows(plan: PreflightPlan) -> Iterator[Row]:
    """Those of weights and data by policy, and of the clips as an export tells them."""
    for text in PROFILES[plan.policy].licences if plan.policy in PROFILES else ():
        what, _, terms = text.partition(": ")
        yield ROWS.note(what, plan.policy, terms)
    path = None if plan.data is None else plan.data / EXPORT_SUMMARY
    if path is None or not path.is_file():
        yield ROWS.not_checked("clips", plan.data or "--data", f"there is no {EXPORT_SUMMARY} that tells licences")
        return
    try:
        summary = read_json(path, "summary of an export", _LARGEST)
        licences = {str(name): int(count) for name, count in summary["licences"].items()}
    except (InputError, AttributeError, KeyError, TypeError, ValueError):
        yield ROWS.not_checked("clips", path, "it tells no licences")
        return
    yield ROWS.note("clips", path, ", ".join(f"{count} clips: {name}" for name, count in licences.items()))

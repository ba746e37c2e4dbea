"""Is the data readable through the recipe's own contract, and does the chunk selection take what it says?"""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.recipe_folder import EVENTS, RecipeFolder, selected_numbers
from olt_sft_recipes.preflight.rows import Row, RowMaker, problems_of
from olt_sft_recipes.preflight.saturation_rows import saturation_row
from olt_toolkit.clips.pai_layout import (
    CALIBRATIONS,
    CLIP_INDEX,
    EGOMOTION,
    FEATURE_PRESENCE,
    FEATURE_TABLE,
    FRAME_TIMESTAMPS,
    VIDEO,
)
from olt_toolkit.clips.pai_tables import read_indexed
from olt_toolkit.clips.parquet_files import open_parquet

T = TypeVar("T")
ROWS = RowMaker("data")
_DECODED = 4
"""Clips whose images are decoded: 16 images of a clip take about half a second."""
_COUNTED = 2000
"""Clips whose saturated tokens are counted, while time allows: about 2 ms each."""
_EXPORT = "export it again with `olt data export`"


def data_rows(plan: PreflightPlan) -> tuple[list[Row], int | None]:
    """Rows of training and validation data, and the number of training samples; None where it cannot be told."""
    if plan.data is None:
        return [ROWS.not_checked("folder", "--data", "no folder was given")], None
    deadline = time.monotonic() + plan.seconds
    folder = RecipeFolder(plan.data)
    rows, selected = _look(folder, "train", plan.chunk_ids, plan, deadline)
    if plan.val_data is None:
        rows.append(ROWS.not_checked("val folder", "--val-data", "no folder of validation data was given"))
        return rows, None if selected is None else len(selected)
    val_folder = folder if plan.val_data == plan.data else RecipeFolder(plan.val_data)
    val_rows, val_selected = _look(val_folder, "val", plan.val_chunk_ids, plan, deadline + 0.5 * plan.seconds)
    rows += val_rows
    if selected is not None and val_selected is not None:
        both = sorted(selected.keys() & val_selected.keys())
        wrong = [f"{len(both)} clips are trained on and validated with, as {both[0]}"] if both else []
        good = "no clip of the one is in the other, by their ids"
        rows.append(ROWS.judge("train and val apart", plan.val_data, wrong, good, "choose chunk ids that do not meet"))
    return rows, None if selected is None else len(selected)


def _look(
    folder: RecipeFolder, part: str, chunk_ids: str | None, plan: PreflightPlan, deadline: float
) -> tuple[list[Row], dict[str, int] | None]:
    rows = [
        _features_row(folder, part, plan),
        _readable(
            folder, part, CLIP_INDEX, lambda: f"{len(folder.index)} clips in {len(set(folder.chunks.values()))} chunks"
        ),
        _readable(folder, part, FEATURE_PRESENCE, lambda: _read_presence(folder)),
    ]
    if any(row.verdict != "passed" for row in rows[:2]):
        rows.append(ROWS.not_checked(f"{part} clips", folder.root, "its tables cannot be read"))
        return rows, None
    try:
        selected = folder.select(chunk_ids)
    except InputError as error:
        return [*rows, ROWS.failed(f"{part} chunks", folder.root, str(error), "correct --chunk-ids")], None
    rows.append(_selection_row(folder, part, chunk_ids, selected))
    if len(selected) == 0:
        return rows, selected
    rows.append(_held_out_row(folder, part, selected))
    rows += _file_rows(folder, part, selected, plan)
    rows += _clip_rows(folder, part, selected, plan, deadline)
    if part == "train":
        wanted = spread(list(selected), _COUNTED)
        rows.append(saturation_row(folder, part, wanted, len(selected), plan, time.monotonic() + plan.seconds / 3))
    return rows, selected


def _readable(folder: RecipeFolder, part: str, name: str, look: Callable[[], str]) -> Row:
    try:
        return ROWS.passed(f"{part} {name}", folder.root / name, look())
    except InputError as error:
        return ROWS.failed(f"{part} {name}", folder.root / name, str(error), _EXPORT)


def _read_presence(folder: RecipeFolder) -> str:
    table = read_indexed(folder.root / FEATURE_PRESENCE, [], ["clip_id"])
    return f"{len(table)} clips"


def _features_row(folder: RecipeFolder, part: str, plan: PreflightPlan) -> Row:
    """The loader takes each camera from directory `camera` and motion from `labels`, by attributes of those names."""

    def look() -> str:
        wanted: dict[str, tuple[str, tuple[str, ...]]]
        wanted = dict.fromkeys(plan.contract.cameras, ("camera", (VIDEO, FRAME_TIMESTAMPS)))
        wanted[EGOMOTION] = ("labels", (EGOMOTION,))
        for name, (directory, aliases) in wanted.items():
            feature = folder.features.get(name)
            if feature is None or feature.directory != directory:
                raise InputError(f"no row {name} in directory {directory}, which {plan.contract.name} needs")
            if not feature.chunk_path.endswith(".zip"):
                raise InputError(f"row {name} is not in zip files")
            for alias in aliases:
                feature.member(alias, "")
        return f"{len(plan.contract.cameras)} cameras of {plan.contract.name} and {EGOMOTION}"

    return _readable(folder, part, FEATURE_TABLE, look)


def _selection_row(folder: RecipeFolder, part: str, chunk_ids: str | None, selected: dict[str, int]) -> Row:
    check, where = f"{part} chunks", f"{folder.root / CLIP_INDEX}: chunk_ids {chunk_ids or 'not given: all'}"
    there, taken = sorted(folder.chunks.values()), sorted(selected.values())
    if len(selected) == 0:
        why = "a text without '-' selects nothing" if chunk_ids and "-" not in chunk_ids else "no clip has these chunks"
        action = f"write {there[0]}-{there[-1] + 1} for all that is there" if there else _EXPORT
        return ROWS.failed(check, where, f"0 of {len(there)} clips are selected: {why}", action)
    said = f"{len(selected)} of {len(there)} clips are selected, of chunks {taken[0]} to {taken[-1]}"
    if chunk_ids is None:
        return ROWS.passed(check, where, said)
    numbers = selected_numbers(chunk_ids)
    present = sorted(set(taken))
    notes, first, end = [], numbers[0], numbers[-1] + 1
    if len(present) < len(numbers):
        absent = next(number for number, here in zip(numbers, [*present, None], strict=False) if number != here)
        missing = f"{len(numbers) - len(present)} of its {len(numbers)} chunks have no clip, as {absent}"
        if (present[0], present[-1] + 1) != (first, end):
            action = f"write {present[0]}-{present[-1] + 1}, or fetch the missing chunks"
            return ROWS.failed(check, where, f"{said}; {missing}", action)
        notes.append(missing)
    if left_out := there.count(end):
        notes.append(f"chunk {end} ({left_out} clips) is left out, for the last number does not count")
        end += 1
    if first and (left_out := there.count(first - 1)):
        notes.append(f"chunk {first - 1} ({left_out} clips) is left out, for chunks count from 0")
        first -= 1
    if not notes:
        return ROWS.passed(check, where, said)
    more = f"write {first}-{end} if all of it should be in" if (first, end) != (numbers[0], numbers[-1] + 1) else ""
    return ROWS.note(check, where, "; ".join([said, *notes]), more)


def _held_out_row(folder: RecipeFolder, part: str, selected: dict[str, int]) -> Row:
    """The reader filters by neither column, so what they rule out must not be in the selection."""
    chosen, wrong, looked = folder.index.loc[list(selected)], [], []
    if "clip_is_valid" in chosen:
        looked.append("clip_is_valid")
        invalid = chosen.index[~chosen["clip_is_valid"].astype(bool)]
        wrong += [f"{len(invalid)} clips are not valid, as {invalid[0]}"] if len(invalid) else []
    if "split" in chosen and part == "train":
        looked.append("split")
        other = chosen.index[chosen["split"].isin(["val", "test"])]
        wrong += (
            [f"{len(other)} clips are of split {chosen.at[other[0], 'split']}, as {other[0]}"] if len(other) else []
        )
    check, where = f"{part} clips meant for it", folder.root / CLIP_INDEX
    if not looked:
        return ROWS.not_checked(check, where, "the index has neither clip_is_valid nor split")
    good = f"{len(chosen)} clips, by {' and '.join(looked)}"
    return ROWS.judge(check, where, wrong, good, "the recipe does not look at these columns: take such clips out")


def _file_rows(folder: RecipeFolder, part: str, selected: dict[str, int], plan: PreflightPlan) -> Iterator[Row]:
    """Every archive that the loader would open, and in each the members of every selected clip."""
    names = [*plan.contract.cameras, EGOMOTION]
    by_chunk: dict[int, list[str]] = {}
    for clip_id, chunk in selected.items():
        by_chunk.setdefault(chunk, []).append(clip_id)
    problems = problems_of(
        lambda each: _check_members(folder, *each, by_chunk), [(name, chunk) for chunk in by_chunk for name in names]
    )
    good = f"{len(names) * len(by_chunk)} archives hold all members of {len(selected)} clips"
    yield ROWS.judge(f"{part} chunk files", folder.root, problems, good, _EXPORT)
    known = [name for name in CALIBRATIONS if name in folder.features]
    if len(known) < len(CALIBRATIONS):
        absent = ", ".join(name for name in CALIBRATIONS if name not in known)
        found = f"no row {absent}, which only include_extr_intr and the public devkit need"
        yield ROWS.note(f"{part} calibration", folder.root / FEATURE_TABLE, found)
    problems = problems_of(lambda each: _check_table(folder, *each), [(name, k) for name in known for k in by_chunk])
    good = f"{len(known) * len(by_chunk)} tables open; the loader reads them only with include_extr_intr"
    yield ROWS.judge(f"{part} calibration files", folder.root, problems, good, _EXPORT)


def _check_members(folder: RecipeFolder, name: str, chunk: int, by_chunk: dict[int, list[str]]) -> None:
    archive, feature = folder.archive(name, chunk), folder.features[name]
    aliases = (EGOMOTION,) if name == EGOMOTION else (VIDEO, FRAME_TIMESTAMPS)
    wanted = [feature.member(alias, clip_id) for clip_id in by_chunk[chunk] for alias in aliases]
    lacking = [member for member in wanted if member not in archive]
    if lacking:
        raise InputError(f"{archive.path}: {len(lacking)} members are missing, as {lacking[0]}")


def _check_table(folder: RecipeFolder, name: str, chunk: int) -> None:
    path = folder.features[name].chunk_file(folder.root, chunk)
    with open_parquet(path, str(path)):
        pass


def _clip_rows(
    folder: RecipeFolder, part: str, selected: dict[str, int], plan: PreflightPlan, deadline: float
) -> Iterator[Row]:
    clip_ids = spread(list(selected), plan.clips)
    problems: list[str] = []
    looked = decoded = 0
    sizes: set[tuple[int, int]] = set()
    for number, clip_id in enumerate(clip_ids):
        if number and time.monotonic() > deadline:
            break
        looked += 1
        try:
            t0_us = folder.t0_us(clip_id, plan.use_default_keyframe)
            folder.look_at_clip(clip_id, t0_us, plan.contract)
            if decoded < _DECODED:
                sizes.add(folder.decode_sample(clip_id, t0_us, plan.contract))
                decoded += 1
        except InputError as error:
            problems.append(str(error))
    t0 = "t0 = 5.1 s" if plan.use_default_keyframe else f"the first of {EVENTS}"
    shown = ", ".join(f"{height} x {width}" for height, width in sorted(sizes))
    good = (
        f"{looked} of {len(selected)} clips opened: motion and cameras cover the sample at {t0}, videos have their "
        f"frames; images of {decoded} decoded ({shown})"
    )
    action = f"{_EXPORT}; or set use_default_keyframe={str(not plan.use_default_keyframe).lower()} if t0 is wrong"
    yield ROWS.judge(f"{part} clips", folder.root, problems, good, action)


def spread(items: Sequence[T], count: int) -> list[T]:
    """So many of the items, spread evenly, and in an order that is spread too, for when time runs out."""
    places = np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int)) if items else []
    bits = max(1, len(places).bit_length())
    # The order of van der Corput: the digits of a number, turned round.
    order = sorted(range(len(places)), key=lambda number: int(f"{number:0{bits}b}"[::-1], 2))
    return [items[places[number]] for number in order]

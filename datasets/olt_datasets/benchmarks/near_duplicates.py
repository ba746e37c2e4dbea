"""Near-duplicates: the share of changed copies that is found, false alarms, and what fingerprints cost."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
import polars as pl

from olt_closed_loop.evaluation.score_table import wilson_interval
from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_datasets.benchmarks.copies import KINDS, Drive, copy_window
from olt_datasets.benchmarks.fake_fingerprints import draw_fingerprints
from olt_datasets.tables.fingerprints import search_near_duplicates
from olt_generator.seeds import make_generator
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting
from olt_toolkit.clips.fingerprint import IMAGES, RECORD, fingerprint_images, fingerprint_times

WORLDS, FIRST_SEED = 5, 700
"""Worlds of each category, of seeds on which no limit of the rule was chosen."""
SIZE, FRAME_RATE = (320, 180), 5.0
COPIES = 2
"""Of each world and kind."""
CLEAN_WORLDS = 16
"""Of each category, of which pairs are counted that are taken for one another."""
WINDOWS = ((0.0, 0.6), (0.2, 0.6), (0.4, 0.6))
"""Where they start, and how long they are, as shares of a drive."""
ALIKE = (250, 1000, 4000)
FAKE = (1000, 4000, 16_000)
"""Clips of tables in which none is like another."""


@lru_cache(maxsize=1)
def film_worlds() -> list[Drive]:
    """Drives through invented worlds, one in five by night, all by one camera."""
    return list(_film(range(WORLDS)))


def _film(numbers: Iterable[int]) -> Iterator[Drive]:
    for category in CATEGORIES:
        for number in numbers:
            conditions = Conditions(light="day" if number % 5 else "night")
            scene = generate_scene(category, FIRST_SEED + number)
            film = record_drive(scene, *SIZE, FRAME_RATE, conditions=conditions)
            yield Drive(f"{category} {number}", film.frames, film.timestamps_us)


def fingerprint(drive: Drive, images: int = IMAGES) -> bytes:
    """That of a drive, from so many images."""
    wanted = fingerprint_times(int(drive.times_us[0]), int(drive.times_us[-1]))
    wanted = wanted[(2 * np.arange(images) + 1) * len(wanted) // (2 * images)]
    nearest = np.unique(np.abs(drive.times_us[:, None] - wanted).argmin(axis=0))
    return fingerprint_images(drive.frames[nearest], drive.times_us[nearest])


def make_pairs(drives: Sequence[Drive], kind: str, copies: int = COPIES) -> list[tuple[Drive, Drive]]:
    """Windows of each drive with copies of them, changed in one way."""
    return [
        copy_window(drive, kind, make_generator("copies", kind, drive.name, number))
        for drive in drives
        for number in range(copies)
    ]


def count_found(pairs: Sequence[tuple[Drive, Drive]], images: int = IMAGES) -> int:
    """Of how many copies the drive is found, each looked for among the windows of all."""
    windows, copies = zip(*pairs, strict=True)
    search = search_near_duplicates(_table(copies, images), _table(windows, images))
    return sum(copies[place].name == windows[other].name for place, other in search.pairs)


def count_alarms(drives: Iterable[Drive]) -> tuple[int, int]:
    """How many pairs of windows of drives of different names are found to be alike, and of how many."""
    looks = [(drive.name, fingerprint(drive)) for drive in drives]
    names = pl.Series([name for name, _ in looks])
    table = _frame([look for _, look in looks], names.to_list())
    of_a_name = names.value_counts()["count"]
    pairs = (len(looks) ** 2 - int((of_a_name**2).sum())) // 2
    return len({frozenset(pair) for pair in search_near_duplicates(table, table).pairs.tolist()}), pairs


def _table(drives: Sequence[Drive], images: int) -> pl.LazyFrame:
    return _frame([fingerprint(drive, images) for drive in drives], [None] * len(drives))


def _frame(fingerprints: Sequence[bytes], scenes: Sequence[str | None]) -> pl.LazyFrame:
    rows = {"fingerprint": fingerprints, "scene_id": scenes}
    return pl.LazyFrame(rows, schema={"fingerprint": pl.Binary, "scene_id": pl.String})


@lru_cache(maxsize=1)
def _mixed_pairs() -> list[tuple[Drive, Drive]]:
    return [pair for kind in KINDS for pair in make_pairs(film_worlds()[::3], kind, copies=1)]


def _prepare(images: int) -> Callable[[], dict[str, float]]:
    pairs = _mixed_pairs()

    def search() -> dict[str, float]:
        return {"missed": 100.0 * (1.0 - count_found(pairs, images) / len(pairs)), "bytes": images * RECORD.itemsize}

    return search


def _measure_alike(clips: int) -> dict[str, Any]:
    """Time and found clips where all clips are copies of one."""
    look = fingerprint(film_worlds()[1])
    return {"alike clips": clips} | _time_search(_frame([look] * clips, [f"scene {n}" for n in range(clips)]), clips)


def _measure_fake(clips: int) -> dict[str, Any]:
    """Time and alarms where no clip is a copy of one."""
    looks = [images.tobytes() for images in draw_fingerprints(clips, FIRST_SEED)]
    return {"fake clips": clips} | _time_search(_frame(looks, [f"scene {n}" for n in range(clips)]), clips)


def _time_search(table: pl.LazyFrame, clips: int) -> dict[str, Any]:
    """Clips of a table that are found in it, and how long that takes."""
    start = time.process_time()
    search = search_near_duplicates(table, table)
    spent = time.process_time() - start
    return {"found": len(search.pairs), "crowded": len(search.crowded), "processor_ms_a_clip": 1e3 * spent / clips}


def _grid() -> Grid:
    drives = film_worlds()
    rows: list[dict[str, Any]] = []
    for kind in KINDS:
        pairs = make_pairs(drives, kind)
        found = count_found(pairs)
        low, high = wilson_interval(found, len(pairs))
        rows.append({"kind": kind, "copies": len(pairs), "found": found, "low": low, "high": high})
    windows = (drive.window(*window) for drive in _film(range(CLEAN_WORLDS)) for window in WINDOWS)
    alarms, clean = count_alarms(windows)
    costs = [*map(_measure_alike, ALIKE), *map(_measure_fake, FAKE)]
    summary = [
        f"{row['kind']}: {row['found']} of {row['copies']} found (95 %: {row['low']:.1%} to {row['high']:.1%})"
        for row in rows
    ] + [
        f"false alarms: {alarms} in {clean:,} pairs of windows of {CLEAN_WORLDS * len(CATEGORIES)} worlds",
        *map(_word_cost, costs),
    ]
    return Grid([*rows, {"clean pairs": clean, "alarms": alarms}, *costs], summary)


def _word_cost(row: dict[str, Any]) -> str:
    kind = next(iter(row))
    return (
        f"{row[kind]:,} {kind}: {row['processor_ms_a_clip']:.2f} ms of processor each, {row['found']:,} found, "
        f"{row['crowded']:,} not compared in full"
    )


BENCHMARK = Benchmark(
    title=f"Copies of {len(CATEGORIES) * WORLDS // 3} synthetic drives, one of each of {len(KINDS)} kinds of change",
    error_name="copies that are not found",
    error_unit="%",
    reference="which drive each copy was made from",
    settings=lambda: [Setting(f"{n} images", partial(_prepare, n), default=n == IMAGES) for n in (2, 4, 8, IMAGES)],
    measure_error=lambda found: found["missed"],
    figures=lambda found: {"fingerprint, bytes": found["bytes"]},
    grid=_grid,
)

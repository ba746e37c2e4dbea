"""Near-duplicates: the share of changed copies that is found, false alarms, and what fingerprints cost."""

import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
import polars as pl

from olt_closed_loop.evaluation.score_table import wilson_interval
from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.procedural import CATEGORIES, generate_scene
from olt_closed_loop.sensors.recorder import record_drive
from olt_datasets.benchmarks.copies import KINDS, Drive, copy_window
from olt_datasets.tables.fingerprints import search_near_duplicates
from olt_generator.seeds import make_generator
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting
from olt_toolkit.clips.fingerprint import IMAGES, RECORD, fingerprint_images, fingerprint_times

WORLDS, FIRST_SEED = 5, 700
"""Worlds of each category, of seeds on which no limit of the rule was chosen."""
SIZE, FRAME_RATE = (320, 180), 5.0
COPIES = 2
"""Of each world and kind."""
ALIKE = (250, 1000, 4000)


@lru_cache(maxsize=1)
def film_worlds() -> list[Drive]:
    """Drives through invented worlds, one in five by night, all by one camera."""
    drives = []
    for category in CATEGORIES:
        for number in range(WORLDS):
            conditions = Conditions(light="night" if number == 0 else "day")
            scene = generate_scene(category, FIRST_SEED + number)
            film = record_drive(scene, *SIZE, FRAME_RATE, conditions=conditions)
            drives.append(Drive(f"{category} {number}", film.frames, film.timestamps_us))
    return drives


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


def count_alarms(drives: Sequence[Drive], images: int = IMAGES) -> tuple[int, int]:
    """How many drives are found to be like another one, and of how many pairs of different drives."""
    table = _table(drives, images, named=True)
    return len(search_near_duplicates(table, table).pairs), len(drives) * (len(drives) - 1)


def _table(drives: Sequence[Drive], images: int, named: bool = False) -> pl.LazyFrame:
    rows = {"fingerprint": [fingerprint(drive, images) for drive in drives]}
    scenes = [drive.name if named else None for drive in drives]
    return pl.LazyFrame(rows | {"scene_id": scenes}, schema={"fingerprint": pl.Binary, "scene_id": pl.String})


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
    drive = film_worlds()[1]
    table = pl.LazyFrame(
        {"fingerprint": [fingerprint(drive)] * clips, "scene_id": [f"scene {n}" for n in range(clips)]}
    )
    start = time.process_time()
    found = len(search_near_duplicates(table, table).pairs)
    return {"alike clips": clips, "found": found, "processor_seconds": round(time.process_time() - start, 2)}


def _grid() -> Grid:
    drives = film_worlds()
    rows: list[dict[str, Any]] = []
    for kind in KINDS:
        pairs = make_pairs(drives, kind)
        found = count_found(pairs)
        low, high = wilson_interval(found, len(pairs))
        rows.append({"kind": kind, "copies": len(pairs), "found": found, "low": low, "high": high})
    alarms, clean = count_alarms(drives)
    alike = [_measure_alike(clips) for clips in ALIKE]
    summary = [
        f"{row['kind']}: {row['found']} of {row['copies']} found (95 %: {row['low']:.1%} to {row['high']:.1%})"
        for row in rows
    ] + [
        f"false alarms: {alarms} in {clean:,} ordered pairs of different worlds",
        *(
            f"{row['alike clips']:,} alike clips: {row['found']:,} found in {row['processor_seconds']} s of processor"
            for row in alike
        ),
    ]
    return Grid([*rows, {"clean pairs": clean, "alarms": alarms}, *alike], summary)


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

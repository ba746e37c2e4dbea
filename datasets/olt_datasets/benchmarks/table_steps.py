"""What each step on a clip table takes at a number of rows, measured in a process of its own."""

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa

from olt_datasets import check_recipe, compose_mixture, scan_clip_tables
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.tables.choices import SplitRule
from olt_datasets.tables.clip_frame import replace_column, rewrite_rows
from olt_datasets.tables.cutting import Cutting
from olt_datasets.tables.fake_table import write_fake_table
from olt_datasets.tables.indexing import index_dataset
from olt_datasets.tables.leaks import find_table_leaks
from olt_datasets.tables.splits import Splitting, split_table
from olt_generator.progress import Progress, silent
from olt_toolkit import DatasetPlace
from olt_toolkit.bench.runner import resident_mib
from olt_toolkit.recordings.drives import Drive, Licence
from olt_toolkit.rigs.rig import FRONT_WIDE

WINDOWS_OF_A_DRIVE = 4
FRONT_US = 100_000 * np.arange(42 * WINDOWS_OF_A_DRIVE, dtype=np.int64)

RECIPE = parse_recipe(
    {
        "name": "benchmark",
        "description": "The shape of the paper's recipes: one keyframe of each drive.",
        "version": 1,
        "samples": 12_000,
        "components": [
            {
                "name": "nominal",
                "where": {"kind": "GT", "source": ["pav"], "category": ["nominal"]},
                "share": 0.8,
                "t0": "keyframe",
                "repeats": 100,
            },
            {
                "name": "long_tail",
                "where": {"kind": "Syn", "source": ["pav"], "category_not": ["nominal"]},
                "share": 0.2,
                "t0": "keyframe",
                "repeats": 100,
            },
        ],
    },
    "benchmark",
)


class InventedDrives:
    """So many drives of four windows, of which nothing is on disk."""

    source = "invented"
    licence = Licence("none", "Invented.", "Everything is allowed.")

    def __init__(self, count: int) -> None:
        self._count = count

    def keys(self) -> list[str]:
        """One for each drive."""
        return [f"{number:09d}" for number in range(self._count)]

    def drive(self, key: str) -> Drive:
        """A front camera at 10 Hz, with ego motion."""
        span = (0, int(FRONT_US[-1]))
        return Drive(self.source, f"{self.source}/{key}", key, FRONT_US, ("front",), span, (FRONT_WIDE,))


class InventedPlace(DatasetPlace):
    """Opens invented drives: as many as its path is called."""

    def open(self) -> Any:
        """Open the data set."""
        return InventedDrives(int(self.path.name))


def measure_steps(rows: int, index_rows: int, on_progress: Progress = silent) -> list[dict[str, Any]]:
    """Steps on a table of `rows` clips, and indexing of `index_rows` on one worker; no fingerprints are compared.

    Returns:
        A JSON-able object for each step: its name, rows, seconds, processor seconds, rows by processor second, and the
        peak memory of its process in MiB, None where the system does not tell.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table, leaking, out = (folder / f"{name}.parquet" for name in ("clips", "leaking", "out"))
        steps: dict[str, tuple[int, Callable[[], object]]] = {
            "index": (index_rows, partial(_index, index_rows, folder / "indexed.parquet")),
            "index again": (index_rows, partial(_index, index_rows, folder / "indexed.parquet")),
            "read": (rows, partial(scan_clip_tables, [table])),
            "split seen": (rows, partial(split_table, table, Splitting(SplitRule.SEEN), out)),
            "split unseen": (rows, partial(split_table, table, Splitting(SplitRule.UNSEEN), out)),
            "check": (rows, partial(_find_leaks, table)),
            "check, all scenes leak": (rows, partial(_find_leaks, leaking)),
            "mix check": (rows, partial(_check, table)),
            "mix compose": (rows, partial(_compose, table)),
        }
        write_fake_table(table, rows, with_fingerprints=False)
        rewrite_rows(table, leaking, _split_scenes)
        results = []
        for place, (step, (count, work)) in enumerate(steps.items()):
            if count:
                results.append({"step": step, "rows": count} | _measure_apart(work, count))
            on_progress((place + 1) / len(steps))
        return results


def _measure_apart(work: Callable[[], object], rows: int) -> dict[str, Any]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measure, work, rows).result()


def _measure(work: Callable[[], object], rows: int) -> dict[str, Any]:
    start, start_of_processor = time.perf_counter(), time.process_time()
    work()
    seconds, processor_seconds = time.perf_counter() - start, time.process_time() - start_of_processor
    peak_mib = resident_mib("VmHWM")
    return {
        "seconds": round(seconds, 1),
        "processor_seconds": round(processor_seconds, 1),
        "rows_per_processor_second": round(rows / processor_seconds),
        "peak_memory_mib": None if peak_mib is None else round(peak_mib),
    }


def _index(rows: int, table: Path) -> None:
    place = InventedPlace(Path(str(rows // WINDOWS_OF_A_DRIVE)), source="invented")
    index_dataset(place, table, Cutting(), workers=1, with_fingerprints=False)


def _split_scenes(rows: pa.Table, start: int) -> pa.Table:
    """Rows of which every other is of split test, so that each scene is of two splits."""
    splits = pl.select(pl.when(pl.int_range(len(rows)) % 2 == 0).then(pl.lit("train")).otherwise(pl.lit("test")))
    return replace_column(rows, "split", splits.to_series())


def _find_leaks(table: Path) -> None:
    find_table_leaks(scan_clip_tables([table]), out=table.with_name("leaks.parquet"))


def _check(table: Path) -> None:
    check_recipe(RECIPE, scan_clip_tables([table]))


def _compose(table: Path) -> None:
    compose_mixture(RECIPE, scan_clip_tables([table]), seed=0, allow_uncompared=True)

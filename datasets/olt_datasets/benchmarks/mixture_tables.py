"""What composing a mixture from a fake clip table of any size takes."""

import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from olt_datasets.mixtures.mixture import compose_mixture
from olt_datasets.mixtures.recipe import parse_recipe
from olt_datasets.tables.clip_frame import scan_clip_tables
from olt_datasets.tables.fake_table import LONG_TAIL, write_fake_table
from olt_toolkit.bench.runner import resident_mib


def compose_at_scale(clips: int) -> dict[str, Any]:
    """Write a table of so many clips, compose a mixture from it in a process of its own, and measure that.

    Returns:
        Number of clips and samples, seconds of wall and of processor, and the process's peak memory in MiB, None where
        the system does not tell.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clips.parquet"
        write_fake_table(path, clips)
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(_measure_composing, path, clips).result()


def _measure_composing(path: Path, clips: int) -> dict[str, Any]:
    start, start_of_processor = time.perf_counter(), time.process_time()
    mixture = compose_mixture(_recipe(clips), scan_clip_tables([path]), seed=0)
    seconds, processor_seconds = time.perf_counter() - start, time.process_time() - start_of_processor
    peak_mib = resident_mib("VmHWM")
    return {
        "clips": clips,
        "samples": len(mixture),
        "seconds": round(seconds, 3),
        "processor_seconds": round(processor_seconds, 3),
        "peak_memory_mib": None if peak_mib is None else round(peak_mib),
    }


def _recipe(clips: int) -> Any:
    """The shape of the paper's recipes: ordinary drives and synthesized long-tail ones, one keyframe of each."""
    samples = min(10_000, clips // 20)
    nominal = {"kind": "GT", "source": ["pav"], "category": ["nominal"]}
    long_tail = {"kind": "Syn", "source": ["pav"], "category": list(LONG_TAIL)}
    content = {
        "name": "benchmark",
        "description": "made up",
        "version": 1,
        "components": [
            {"name": "nominal", "where": nominal, "count": samples, "t0": "keyframe"},
            {"name": "long_tail", "where": long_tail, "count": samples // 4, "t0": "keyframe"},
        ],
    }
    return parse_recipe(content, "benchmark")

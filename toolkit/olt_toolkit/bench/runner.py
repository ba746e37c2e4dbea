"""Measures the settings of a registered benchmark, each in a process of its own."""

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from importlib.metadata import entry_points
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.bench.benchmark import Benchmark
from olt_toolkit.runtime.environment import describe_machine
from olt_toolkit.runtime.threads import use_one_thread

GROUP = "olt.benchmarks"


def benchmark_names() -> list[str]:
    """Names of all registered benchmarks."""
    return sorted(entry.name for entry in entry_points(group=GROUP))


def load_benchmark(name: str) -> Benchmark:
    """The registered benchmark of that name; an `InputError` where there is none."""
    found = entry_points(group=GROUP, name=name)
    if not found:
        raise InputError(f"no benchmark {name!r}; there are {', '.join(benchmark_names())}")
    return next(iter(found)).load()


def run_benchmark(name: str, repeats: int, on_progress: Progress = silent) -> dict[str, Any]:
    """Measure every setting of a benchmark.

    Returns:
        A JSON-able object with, per setting, the error, the benchmark's other figures, the median and quartiles of the
        run times in seconds, the peak memory above the start of the call in MiB (None where the system does not tell),
        whether the setting is on the Pareto front, and the machine.
    """
    benchmark = load_benchmark(name)
    settings = benchmark.settings()
    rows = []
    for index, setting in enumerate(settings):
        # A fresh process per setting: no setting profits from another's warm caches or freed memory.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=use_one_thread) as pool:
            times, peak_mib, result = pool.submit(_measure, name, index, repeats).result()
        first, median, third = np.quantile(times, (0.25, 0.5, 0.75)).tolist()
        rows.append(
            {
                "setting": setting.name,
                "default": setting.default,
                "error": float(benchmark.measure_error(result)),
                "figures": {} if benchmark.figures is None else dict(benchmark.figures(result)),
                "median_s": median,
                "first_quartile_s": first,
                "third_quartile_s": third,
                "runs": len(times),
                "peak_memory_mib": peak_mib,
            }
        )
        on_progress((index + 1) / len(settings))
    for row, on_front in zip(rows, pareto_front([(row["error"], row["median_s"]) for row in rows]), strict=True):
        row["pareto"] = on_front
    return {
        "benchmark": name,
        **{name: getattr(benchmark, name) for name in ("title", "error_name", "error_unit", "reference")},
        "settings": rows,
        "machine": describe_machine(),
    }


def pareto_front(costs: Sequence[tuple[float, float]]) -> list[bool]:
    """Whether each (error, seconds) is beaten by no other: none is better in one of them and no worse in the other."""
    return [
        all(other == (error, seconds) for other in costs if other[0] <= error and other[1] <= seconds)
        for error, seconds in costs
    ]


def resident_mib(field: str) -> float | None:
    """Memory of this process in MiB: "VmRSS" now, "VmHWM" at its peak; None where the system does not tell."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    kib = next((line.split()[1] for line in status.splitlines() if line.startswith(field + ":")), None)
    return None if kib is None else int(kib) / 1024


def _measure(name: str, index: int, repeats: int) -> tuple[list[float], float | None, Any]:
    call = load_benchmark(name).settings()[index].prepare()
    before = resident_mib("VmRSS")
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # Linux: the peak starts anew from the present size
    result = call()  # warms caches and is the result that is judged
    peak = resident_mib("VmHWM")
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return times, None if before is None or peak is None else round(max(peak - before, 0.0), 2), result

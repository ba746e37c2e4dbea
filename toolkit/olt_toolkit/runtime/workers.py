"""Work on several processes, or on the machines of a Ray cluster, each worker with one thread per numerical library."""

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from enum import StrEnum
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.threads import use_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")


class Engine(StrEnum):
    """Where parallel work is done: in processes of this machine, or on a Ray cluster."""

    LOCAL = "local"
    RAY = "ray"


def default_workers() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# Between being asked to end and being ended: what is half-written is removed in it.
_SECONDS_TO_END = 10.0
_kept: ProcessPoolExecutor | None = None
"""Processes that stay from one call of `map_parallel` to the next, within `kept_workers`."""


@contextmanager
def kept_workers(workers: int) -> Iterator[None]:
    """Within it, `map_parallel` of this process works on the same up to `workers` processes again and again.

    A process imports what it works with, which takes seconds of a processor; a job of several steps pays that once.
    After a failure the processes are gone, and the next call starts its own.
    """
    global _kept
    _kept = _start_pool(workers) if workers > 1 else None
    try:
        yield
    finally:
        if _kept is not None:
            _kept.shutdown(cancel_futures=True)
        _kept = None


def map_parallel(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    on_progress: Progress = silent,
    engine: Engine = Engine.LOCAL,
) -> list[Result]:
    """Apply `function` to all items on up to `workers` processes; results keep the order of the items.

    The first failure stops the rest and is raised. `function` and the items must be picklable.

    Raises:
        InputError: Ray is asked for and cannot be used.
    """
    if engine is Engine.RAY:
        from olt_toolkit.runtime.ray_engine import map_on_ray

        return map_on_ray(function, items, workers, on_progress)
    global _kept
    results: dict[int, Result] = {}
    if workers <= 1 or len(items) <= 1:
        for index, item in enumerate(items):
            results[index] = function(item)
            on_progress((index + 1) / len(items))
        return list(results.values())
    pool = _kept or _start_pool(min(workers, len(items)))
    try:
        futures = {pool.submit(_work, function, item): index for index, item in enumerate(items)}
        for future in as_completed(futures):
            results[futures[future]] = future.result()
            on_progress(len(results) / len(items))
    except BaseException:
        _end(pool)
        if pool is _kept:
            _kept = None
        raise
    if pool is not _kept:
        pool.shutdown()
    return [results[index] for index in range(len(items))]


@contextmanager
def working_ahead(function: Callable[[Item], Result], workers: int) -> Iterator[Callable[[Item], Future[Result]]]:
    """Yield what has `function` applied to an item on one of `workers` processes, while this one goes on.

    Items are begun in the order in which they are given. When the context is left, the processes end, also those that
    work. `function`, which each process is handed once, and the items must be picklable.
    """
    with TemporaryDirectory() as folder:
        # In a file: starting a process waits until the process has read what it is handed, having imported much.
        path = Path(folder) / "function"
        path.write_bytes(pickle.dumps(function))
        pool = _start_pool(workers, path)
        try:
            yield lambda item: pool.submit(_work_ahead, item)
        finally:
            _end(pool)


def _start_pool(workers: int, function: Path | None = None) -> ProcessPoolExecutor:
    context = get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(function,))


def _end(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool, also those that work."""
    processes = list((pool._processes or {}).values())
    for process in processes:  # a started task cannot be cancelled otherwise
        process.terminate()
    # A library that catches everything while it is imported passes over that.
    killing = threading.Timer(_SECONDS_TO_END, lambda: [process.kill() for process in processes])
    killing.start()
    pool.shutdown(wait=True, cancel_futures=True)
    killing.cancel()


_function: Callable[[Any], Any] | None = None
"""What this process, if it works ahead of another, does to the items that it is given."""


def _start_worker(function: Path | None) -> None:
    # Ctrl-C reaches the whole process group: the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    use_one_thread()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if function is not None:
        global _function
        _function = pickle.loads(function.read_bytes())  # noqa: S301 - its parent has just written it


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for its next item forever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(143)


def _work(function: Callable[[Item], Result], item: Item) -> Result:
    try:
        return function(item)
    except SystemExit:
        os._exit(143)  # told to stop: what was half-written is removed by now, and no further item may start


def _work_ahead(item: Any) -> Any:
    assert _function is not None
    return _work(_function, item)

"""The same work on a Ray cluster: `map_parallel` with the engine `ray`.

All machines must see the same files under the same paths. The cluster is the one that the variable RAY_ADDRESS names;
without it, one is started on this machine, on loopback, and ended with the work. A task whose worker process or machine
dies is started again, up to `RETRIES` times: that is safe because every task writes its result whole or not at all. A
task that fails by itself is not, and ends the rest.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from olt_generator.errors import InputError
from olt_generator.progress import Progress, silent
from olt_toolkit.runtime.threads import THREAD_VARIABLES, use_one_thread

Item = TypeVar("Item")
Result = TypeVar("Result")

RETRIES = 3
ADDRESS_VARIABLE = "RAY_ADDRESS"


def map_on_ray(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int, on_progress: Progress = silent
) -> list[Result]:
    """Apply `function` to all items on Ray, `workers` at the same time at most; results keep the order of the items.

    The function and the items' types must be importable on every machine.

    Raises:
        InputError: Ray is not installed, or the cluster cannot be reached, or a worker died too often.
    """
    try:
        import ray
        from ray.exceptions import RayTaskError, WorkerCrashedError
    except ImportError as error:
        raise InputError(
            "the engine 'ray' needs Ray; install it with `pip install openlongtail[distributed]`"
        ) from error
    with _cluster(ray, workers):
        task = ray.remote(max_retries=RETRIES, num_cpus=1)(_work)
        results: dict[int, Result] = {}
        running: dict[Any, int] = {}
        waiting = iter(range(len(items)))
        try:
            while len(results) < len(items):
                for index in islice(waiting, workers - len(running)):
                    running[task.remote(function, items[index])] = index
                finished, _ = ray.wait(list(running))
                for reference in finished:
                    results[running.pop(reference)] = ray.get(reference)
                on_progress(len(results) / len(items))
        except RayTaskError as error:
            raise error.cause from None
        except WorkerCrashedError as error:
            raise InputError(
                f"a Ray worker died {RETRIES + 1} times over the same item; look into its machine"
            ) from error
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
        return [results[index] for index in range(len(items))]


@contextmanager
def _cluster(ray: Any, workers: int) -> Iterator[None]:
    """Connected to the cluster, and away from it again; one that is already connected is left as it is."""
    if ray.is_initialized():
        yield
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anybody unless the user wants it
    where: dict[str, Any] = {"num_cpus": workers, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    if ADDRESS_VARIABLE in os.environ:
        where = {"address": os.environ[ADDRESS_VARIABLE]}
    variables = {"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")}
    try:
        ray.init(runtime_env=variables, log_to_driver=False, logging_level="error", **where)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise InputError(f"the Ray cluster cannot be used: {error}; check {ADDRESS_VARIABLE}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _work(function: Callable[[Item], Result], item: Item) -> Result:
    use_one_thread()
    return function(item)

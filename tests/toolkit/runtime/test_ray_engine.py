import os
import signal

import pytest

from olt_generator.errors import InputError
from olt_toolkit.runtime.workers import Engine, map_parallel

ray = pytest.importorskip("ray", reason="needs the extra `distributed`")


def square(number):
    return number * number


def thread_settings(_):
    import cv2

    return cv2.getNumThreads(), os.environ["OMP_NUM_THREADS"], os.getpid()


def refuse_two(number):
    if number == 2:
        raise InputError("item 2: is refused")
    return number


def die_once(marker):
    """Ends its own process the first time, as a machine that fails would."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return marker.name


def die_always(_):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def cluster():
    ray.init(num_cpus=2, include_dashboard=False, _node_ip_address="127.0.0.1", log_to_driver=False)
    yield
    ray.shutdown()


def map_on_ray(function, items, on_progress=lambda share: None):
    return map_parallel(function, items, 2, on_progress, Engine.RAY)


def test_results_keep_the_order_of_the_items(cluster):
    shares = []
    assert map_on_ray(square, range(7), shares.append) == [0, 1, 4, 9, 16, 25, 36]
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_workers_have_one_thread(cluster):
    threads, _, process = map_on_ray(thread_settings, [0])[0]
    assert threads == 1 and process != os.getpid()


def test_a_killed_worker_is_replaced(cluster, tmp_path):
    markers = [tmp_path / "first", tmp_path / "second", tmp_path / "third"]
    assert map_on_ray(die_once, markers) == ["first", "second", "third"]


def test_a_refused_item_is_refused_in_the_same_words(cluster):
    with pytest.raises(InputError, match=r"^item 2: is refused$"):
        map_on_ray(refuse_two, range(4))


def test_no_items_need_no_tasks(cluster):
    assert map_on_ray(square, []) == []


@pytest.mark.slow
def test_an_item_that_always_kills_its_worker_is_an_error(cluster):
    with pytest.raises(InputError, match="died"):
        map_on_ray(die_always, [0])


@pytest.mark.slow
def test_a_cluster_is_started_where_there_is_none_and_ended(monkeypatch):
    ray.shutdown()
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert map_on_ray(square, range(3)) == [0, 1, 4]
    assert not ray.is_initialized()

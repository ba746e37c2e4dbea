import multiprocessing
import os
import time
from contextlib import suppress

import pytest

from olt_generator.files import write_whole
from olt_toolkit.runtime.workers import kept_workers, map_parallel, working_ahead


def square(number):
    return number * number


def sleep_or_fail(item):
    if item == 0:
        raise ValueError("item 0")
    time.sleep(60)


def threads_and_process(_):
    import cv2

    return cv2.getNumThreads(), os.environ["OMP_NUM_THREADS"], os.getpid()


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_keep_the_order_of_the_items(workers):
    shares = []
    assert map_parallel(square, range(7), workers, shares.append) == [0, 1, 4, 9, 16, 25, 36]
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_workers_are_other_processes_with_one_thread():
    answers = map_parallel(threads_and_process, [0, 1], 2)
    assert all(answer[:2] == (1, "1") and answer[2] != os.getpid() for answer in answers)


def test_the_first_failure_ends_the_rest():
    start = time.monotonic()
    with pytest.raises(ValueError, match="item 0"):
        map_parallel(sleep_or_fail, [1, 0], 2)
    assert time.monotonic() - start < 50


def sleep_for(seconds):
    time.sleep(seconds)
    return os.getpid()


def test_work_ahead_is_done_by_another_process_that_ends_with_its_context():
    start, others = time.monotonic(), set(multiprocessing.active_children())
    with working_ahead(sleep_for, 1) as submit:
        first, second, endless = submit(0), submit(0), submit(600)
        assert first.result() == second.result() != os.getpid()
    assert endless.done() and not set(multiprocessing.active_children()) - others
    assert time.monotonic() - start < 300


def write_slowly_or_fail(folder):
    if not folder.name.startswith("slow"):
        time.sleep(1)
        raise ValueError("the other item")
    with write_whole(folder / "result.txt") as temporary:
        temporary.write_text("half")
        time.sleep(60)


def test_a_stopped_worker_leaves_nothing_half_written(tmp_path):
    with pytest.raises(ValueError, match="the other item"):
        map_parallel(write_slowly_or_fail, [tmp_path / "slow", tmp_path / "other"], 2)
    assert list((tmp_path / "slow").iterdir()) == []


def go_on_or_fail(item):
    end = time.monotonic() + 120
    if item == 0:
        time.sleep(1)
        raise ValueError("item 0")
    while time.monotonic() < end:
        with suppress(BaseException):
            time.sleep(1)


def test_a_worker_that_passes_over_its_end_is_ended(monkeypatch):
    monkeypatch.setattr("olt_toolkit.runtime.workers._SECONDS_TO_END", 2.0)
    start = time.monotonic()
    with pytest.raises(ValueError, match="item 0"):
        map_parallel(go_on_or_fail, [1, 0], 2)
    assert time.monotonic() - start < 100


def process_of(_):
    time.sleep(0.2)
    return os.getpid()


def test_kept_workers_are_the_same_processes_from_call_to_call():
    with kept_workers(2):
        first, second = (set(map_parallel(process_of, range(4), 2)) for _ in range(2))
    afterwards = set(map_parallel(process_of, range(4), 2))
    assert os.getpid() not in first and second <= first and not afterwards & first


def test_kept_workers_of_one_are_this_process():
    with kept_workers(1):
        assert map_parallel(process_of, range(2), 1) == [os.getpid()] * 2


def test_after_a_failure_kept_workers_are_others():
    with kept_workers(2):
        first = set(map_parallel(process_of, range(4), 2))
        with pytest.raises(ValueError, match="item 0"):
            map_parallel(sleep_or_fail, [1, 0], 2)
        assert not set(map_parallel(process_of, range(4), 2)) & first

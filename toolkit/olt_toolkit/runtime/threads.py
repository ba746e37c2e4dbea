"""One thread for each numerical library: workers share the processors, and sums come out the same everywhere."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""The settings by which these libraries choose how many threads they start."""


def use_one_thread() -> None:
    """Keep OpenCV and torch, where loaded later too, on one thread, so that sums come out the same everywhere."""
    import cv2

    cv2.setNumThreads(1)
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"


@contextmanager
def without_opencv_threads() -> Iterator[None]:
    """To fork inside: a fork lacks OpenCV's threads, and waits for them for ever once it sets their number."""
    cv2 = sys.modules.get("cv2")
    if cv2 is None:
        yield
        return
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)

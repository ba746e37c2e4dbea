"""One thread for each numerical library: workers share the processors, and sums come out the same everywhere."""

import os

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""The settings by which these libraries choose how many threads they start."""


def use_one_thread() -> None:
    """Keep OpenCV and torch, where loaded later too, on one thread, so that sums come out the same everywhere."""
    import cv2

    cv2.setNumThreads(1)
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"

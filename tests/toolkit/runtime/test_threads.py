"""Forks after OpenCV has threads of its own."""

import os
import signal
import sys
import time

import cv2
import numpy as np
import pytest

from olt_toolkit.runtime.threads import use_one_thread, without_opencv_threads

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")


def test_a_fork_does_not_wait_for_threads_that_it_lacks():
    before = cv2.getNumThreads()
    cv2.setNumThreads(4)
    try:
        cv2.GaussianBlur(np.zeros((2000, 2000), np.float32), (0, 0), 9.0)  # starts them
        with without_opencv_threads():
            child = os.fork()
            if child == 0:
                use_one_thread()
                os._exit(0)
        assert cv2.getNumThreads() == 4
        assert ends(child)
    finally:
        cv2.setNumThreads(before)


def ends(child):
    for _ in range(100):
        if os.waitpid(child, os.WNOHANG)[0]:
            return True
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False

"""Fixtures that every test may use."""

import resource
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run, and no deadline: how long an example takes says nothing about whether it is right.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")

SHARED_REAL = Path(__file__).resolve().parents[2] / "shared" / "real"


@pytest.fixture(scope="session")
def shared_real() -> Path:
    """Folder of the real recordings beside the checkout; the test is skipped where it is absent."""
    if not SHARED_REAL.is_dir():
        pytest.skip(f"no real recordings beside the checkout ({SHARED_REAL.parent.name}/{SHARED_REAL.name} is absent)")
    return SHARED_REAL


@pytest.fixture
def full_disk():
    """A context in which no file can grow beyond so many bytes, as on a disk that is full then (EFBIG for ENOSPC)."""

    @contextmanager
    def limit(most_bytes):
        before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.getsignal(signal.SIGXFSZ)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            signal.signal(signal.SIGXFSZ, handler)

    return limit


@pytest.fixture(scope="session")
def fuzzer():
    """The process that reads damaged files; what it read is told at the end of slow runs."""
    from .fuzzing import Fuzzer

    fuzzer = Fuzzer()
    yield fuzzer
    fuzzer.close()
    for reader, count in sorted(fuzzer.executions.items()):
        print(f"fuzzed {reader}: {count} files in {fuzzer.seconds[reader]:.0f} s")

"""One process at a time in a folder."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from olt_generator.errors import InputError
from olt_generator.files import make_folder, naming


@contextmanager
def alone_in(folder: Path, otherwise: str) -> Iterator[None]:
    """Hold the lock of a folder, which is made; the system releases it however this process ends.

    Processes that it starts do not inherit it.

    Raises:
        InputError: another process holds it, and `otherwise` says what it does; or the folder cannot be written.
    """
    path = make_folder(folder) / ".lock"
    with naming(path):
        lock = path.open("w")
    with lock:
        try:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            raise InputError(f"{folder}: {otherwise}") from error
        yield

"""Sessions of a service by name: so many at most, one call of each at a time, and none that is forgotten stays."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import grpc

from olt_closed_loop.drivers.contract import CallRefused

IDLE_SECONDS = 600.0
"""A session of which nothing was heard for so long is dropped."""
MOST_SESSIONS = 64

Kept = TypeVar("Kept")


@dataclass
class _Entry(Generic[Kept]):
    """What is kept for a session (None: not yet, or no longer), and when something was last heard of it."""

    kept: Kept | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    heard: float = field(default_factory=time.monotonic)


class OpenSessions(Generic[Kept]):
    """See the module. For any number of threads; what ends a session waits for the call that is at work."""

    def __init__(
        self,
        most: int = MOST_SESSIONS,
        idle_seconds: float = IDLE_SECONDS,
        on_end: Callable[[Kept], None] = lambda kept: None,
    ) -> None:
        self._most, self._idle_seconds, self._on_end = most, idle_seconds, on_end
        self._open: dict[str, _Entry[Kept]] = {}
        self._lock = threading.Lock()
        self._watch: threading.Timer | None = None

    def open(self, name: str, make: Callable[[], Kept]) -> None:
        """Open a session of what `make` gives; calls of the session wait for it.

        Raises:
            CallRefused: it has no name, one of that name is open, or there are too many.
        """
        if not name:
            raise CallRefused(grpc.StatusCode.INVALID_ARGUMENT, "session without a session_uuid")
        entry: _Entry[Kept] = _Entry()
        with entry.lock:
            self._add(name, entry)
            try:
                entry.kept = make()
            except BaseException:
                with self._lock:
                    del self._open[name]
                raise
            entry.heard = time.monotonic()

    def _add(self, name: str, entry: _Entry[Kept]) -> None:
        with self._lock:
            if name in self._open:
                raise CallRefused(grpc.StatusCode.ALREADY_EXISTS, f"session {name!r} is open")
            if len(self._open) >= self._most:
                raise CallRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, f"{self._most} sessions are open; close one")
            self._open[name] = entry
            self._wait_for_idle()

    @contextmanager
    def using(self, name: str) -> Iterator[Kept]:
        """What is kept for a session, for one call.

        Raises:
            CallRefused: it is not open.
        """
        entry = self._open.get(name) or _Entry()
        with entry.lock:
            if entry.kept is None:
                raise CallRefused(
                    grpc.StatusCode.NOT_FOUND,
                    f"session {name!r} is not open; one without a call for {self._idle_seconds:g} s is dropped",
                )
            try:
                yield entry.kept
            finally:
                entry.heard = time.monotonic()

    def end(self, name: str) -> None:
        """End a session; one that is not open has ended."""
        with self._lock:
            entry = self._open.pop(name, None)
        if entry is not None:
            with entry.lock:
                self._finish(entry)

    def close(self) -> None:
        """End all sessions."""
        for name in list(self._open):
            self.end(name)
        with self._lock:
            if self._watch:
                self._watch.cancel()

    def _finish(self, entry: _Entry[Kept]) -> None:
        kept, entry.kept = entry.kept, None
        if kept is not None:
            self._on_end(kept)

    def _wait_for_idle(self) -> None:
        """Come back when the session that is longest unheard of can be dropped. The lock is held."""
        if self._watch is not None or not self._open:
            return
        first = min(entry.heard for entry in self._open.values())
        self._watch = threading.Timer(max(first + self._idle_seconds - time.monotonic(), 0.05), self._drop_idle)
        self._watch.daemon = True
        self._watch.start()

    def _drop_idle(self) -> None:
        with self._lock:
            heard_before = time.monotonic() - self._idle_seconds
            for name, entry in list(self._open.items()):
                # One whose lock is held is at work, and not idle however long that takes.
                if entry.heard <= heard_before and entry.lock.acquire(blocking=False):
                    del self._open[name]
                    self._finish(entry)
                    entry.lock.release()
            self._watch = None
            self._wait_for_idle()

"""Serving over gRPC, on the loopback interface unless told otherwise: the contract has neither names nor passwords."""

import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc

from olt_closed_loop.drivers.contract import CHANNEL_OPTIONS, Servicer, serve_methods
from olt_closed_loop.drivers.open_sessions import MOST_SESSIONS
from olt_generator.errors import InputError

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 6789
"""Where AlpaSim looks for a driver."""
_THREADS = 16
"""For calls that are answered at once, beside those of sessions that wait for their policies."""
_GRACE_SECONDS = 2.0


@contextmanager
def serving(servicer: Servicer, host: str = LOOPBACK, port: int = 0, sessions: int = MOST_SESSIONS) -> Iterator[int]:
    """Serve so many sessions at once while the block runs; gives the port, which is any free one for 0.

    Raises:
        InputError: the port is taken, or not to be had.
    """
    server = grpc.server(ThreadPoolExecutor(sessions + _THREADS), options=[*CHANNEL_OPTIONS, ("grpc.so_reuseport", 0)])
    server.add_generic_rpc_handlers((serve_methods(servicer),))
    try:
        bound = server.add_insecure_port(f"{host}:{port}")
    except RuntimeError as error:
        raise InputError(f"cannot serve at {host}:{port}; is the port taken? Port 0 takes a free one") from error
    server.start()
    try:
        yield bound
    finally:
        server.stop(_GRACE_SECONDS).wait()


def wait_for_end() -> None:
    """Return when this process is told to end, by Ctrl-C or SIGTERM; what was printed before is out by then."""
    sys.stdout.flush()
    told = threading.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: told.set())
    told.wait()

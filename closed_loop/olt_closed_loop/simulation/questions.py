"""What a policy's process is asked: messages whose arrays go through memory that both processes have.

Through a pipe, the images of one decision take longer than a small policy needs to answer. A question waits in the
memory until its answer has come, so there is one at a time; what does not fit, and everything where a process is not
forked, goes through the pipe.
"""

import mmap
import pickle
from itertools import accumulate
from multiprocessing.connection import Connection
from typing import Any

# Taken only as far as it is used: a batch of 50 decisions with four small cameras, or 7 with large ones.
_MEMORY_BYTES = 64 << 20


def share_memory() -> mmap.mmap:
    """Memory that a process forked from this one has in common with it."""
    return mmap.mmap(-1, _MEMORY_BYTES)


def send_question(connection: Connection, memory: mmap.mmap | None, question: tuple[Any, ...]) -> None:
    """Send a question; its contiguous arrays through the memory if they fit."""
    buffers: list[pickle.PickleBuffer] = []
    body = pickle.dumps(question, protocol=5, buffer_callback=buffers.append)
    raw = [buffer.raw() for buffer in buffers]
    if memory is None or sum(part.nbytes for part in raw) > len(memory):
        connection.send((pickle.dumps(question), ()))
        return
    memory.seek(0)
    for part in raw:
        memory.write(part)
    connection.send((body, tuple(part.nbytes for part in raw)))


def receive_question(connection: Connection, memory: mmap.mmap | None) -> tuple[Any, ...]:
    """What `send_question` sent, in memory of its own.

    Raises:
        EOFError: whoever asks is gone.
    """
    body, sizes = connection.recv()
    buffers: list[bytearray] = []
    if memory is not None:
        with memoryview(memory) as shared:
            ends = list(accumulate(sizes))
            buffers = [bytearray(shared[end - size : end]) for end, size in zip(ends, sizes, strict=True)]
    return pickle.loads(body, buffers=buffers)  # noqa: S301 (the simulator, which forked this process, sent it)

"""What tells a recording from all others where no id stands in the source: a hash of what was recorded."""

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError


def hash_content(*parts: bytes | NDArray[np.generic]) -> str:
    """20 hexadecimal digits (BLAKE2b) of parts of a recording, in their order; of arrays type and shape too."""
    digest = hashlib.blake2b(digest_size=10)
    for part in parts:
        data, told = part, ""
        if not isinstance(part, bytes):
            little = np.ascontiguousarray(part).astype(part.dtype.newbyteorder("<"))
            data, told = little.tobytes(), f"{little.dtype.str} {little.shape}"
        digest.update(f"{told} {len(data)}\x1f".encode())
        digest.update(data)
    return digest.hexdigest()


def read_content(path: Path) -> bytes:
    """A whole file; InputError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); copy it again") from error

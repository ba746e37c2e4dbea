"""What tells a recording from all others where no id stands in the source: a hash of what was recorded."""

import hashlib

import numpy as np
from numpy.typing import NDArray

from olt_datasets.sources.surround import StoredImage
from olt_generator.errors import InputError


def hash_content(*parts: bytes | NDArray[np.generic]) -> str:
    """20 hexadecimal digits (BLAKE2b) of parts of a recording, in their order; of arrays type and shape too."""
    digest = hashlib.blake2b(digest_size=10)
    for part in parts:
        if isinstance(part, bytes):
            told, data = "bytes", part
        else:
            little = part.astype(part.dtype.newbyteorder("<"))
            told, data = f"{little.dtype.str} {little.shape}", little.tobytes()
        digest.update(f"{told} {len(data)}\x1f".encode())
        digest.update(data)
    return digest.hexdigest()


def read_content(file: StoredImage) -> bytes:
    """All bytes of a file, such as a path; InputError where it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); copy it again") from error

"""TFRecord files, read without TensorFlow: byte strings with their lengths and checksums.

A record is its length (uint64), the masked CRC-32C of the length, the bytes, and the masked CRC-32C of the bytes, all
little-endian (TensorFlow's documentation of the format). Files are mapped into memory, so that whoever looks at a part
of a record reads only that part from disk.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

import google_crc32c

from olt_generator.errors import InputError

_HEADER = struct.Struct("<QI")
_FOOTER = struct.Struct("<I")
_MASK_DELTA = 0xA282EAD8


def map_records(path: Path) -> memoryview:
    """The bytes of a TFRecord file, mapped into memory; InputError where it is missing or empty."""
    try:
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); copy it again") from error
    # Most of a record is images, which an index jumps over: reading ahead would load them all.
    mapped.madvise(mmap.MADV_RANDOM)
    return memoryview(mapped)


def record_spans(content: memoryview, where: str) -> Iterator[tuple[int, int]]:
    """Offset and length in bytes of the content of every record; InputError where a length is damaged or cut off."""
    at = number = 0
    while at < len(content):
        if at + _HEADER.size > len(content):
            raise InputError(f"{where}: ends within the length of record {number}; the file was cut off, copy it again")
        length, checksum = _HEADER.unpack_from(content, at)
        if checksum != masked_crc32c(content[at : at + 8]):
            raise InputError(f"{where}: the length of record {number} at byte {at} is damaged; copy the file again")
        start = at + _HEADER.size
        if start + length + _FOOTER.size > len(content):
            raise InputError(f"{where}: ends within record {number}; the file was cut off, copy it again")
        yield start, length
        at, number = start + length + _FOOTER.size, number + 1


def read_record(content: memoryview, offset: int, length: int, where: str) -> bytes:
    """The bytes of one record; InputError where their checksum differs."""
    record = bytes(content[offset : offset + length])
    if _FOOTER.unpack_from(content, offset + length)[0] != masked_crc32c(record):
        raise InputError(f"{where}: the record at byte {offset} is damaged (its checksum differs); copy the file again")
    return record


def masked_crc32c(content: bytes | memoryview) -> int:
    """The checksum that TFRecord files hold: CRC-32C (Castagnoli, as in RFC 3720) turned by 15 bits plus a constant."""
    checksum = google_crc32c.value(bytes(content))
    return (((checksum >> 15) | (checksum << 17)) + _MASK_DELTA) & 0xFFFFFFFF

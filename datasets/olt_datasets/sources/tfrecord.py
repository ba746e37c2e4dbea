"""TFRecord files, read without TensorFlow: byte strings with their lengths and checksums.

A record is its length (uint64), the masked CRC-32C of the length, the bytes, and the masked CRC-32C of the bytes, all
little-endian (TensorFlow's documentation of the format). Files are mapped into memory, so that whoever looks at a part
of a record reads only that part from disk.
"""

import mmap
import struct
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError

_HEADER = struct.Struct("<QI")
_FOOTER = struct.Struct("<I")
# Castagnoli's polynomial, bits reversed; the mask is that of the TFRecord format.
_POLYNOMIAL = 0x82F63B78
_MASK_DELTA = 0xA282EAD8
_LANES = 4096
_SHORT = 16 * _LANES

# States are uint32; numpy's types lose that in shifts by plain integers.
Table = NDArray[Any]


def map_records(path: Path) -> memoryview:
    """The bytes of a TFRecord file, mapped into memory.

    Raises:
        InputError: the file is missing or empty.
    """
    try:
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); copy it again") from error
    # Most of a record is images, which an index jumps over: reading ahead would load them all.
    mapped.madvise(mmap.MADV_RANDOM)
    return memoryview(mapped)


def record_spans(content: memoryview, where: str) -> Iterator[tuple[int, int]]:
    """Offset and length in bytes of the content of every record; checks the lengths and not the content.

    Raises:
        InputError: a length is damaged, or the file ends within a record.
    """
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


def read_record(content: memoryview, offset: int, length: int, where: str) -> memoryview:
    """The bytes of one record, checked against their checksum.

    Raises:
        InputError: they are damaged.
    """
    record = content[offset : offset + length]
    if _FOOTER.unpack_from(content, offset + length)[0] != masked_crc32c(record):
        raise InputError(f"{where}: the record at byte {offset} is damaged (its checksum differs); copy the file again")
    return record


def masked_crc32c(content: bytes | memoryview) -> int:
    """The checksum that TFRecord files hold: CRC-32C turned by 15 bits plus a constant."""
    checksum = crc32c(content)
    return (((checksum >> 15) | (checksum << 17)) + _MASK_DELTA) & 0xFFFFFFFF


def crc32c(content: bytes | memoryview) -> int:
    """CRC-32C (Castagnoli, as in RFC 3720) of some bytes."""
    if len(content) < _SHORT:
        return _crc_of_short(content)
    return _crc_of_long(np.frombuffer(content, np.uint8))


def _crc_of_short(content: bytes | memoryview) -> int:
    table, state = _byte_table().tolist(), 0xFFFFFFFF
    for byte in bytes(content):
        state = table[(state ^ byte) & 0xFF] ^ (state >> 8)
    return state ^ 0xFFFFFFFF


def _crc_of_long(content: NDArray[np.uint8]) -> int:
    """The same, on `_LANES` parts side by side, two bytes a step, put together at the end.

    A CRC is linear over bits. So zeros in front change nothing as long as the state is 0, the state at the start can
    be laid over the first four bytes, and the state after two parts is the state after the first, carried over as many
    zero bytes as the second has, plus the state after the second.
    """
    part = 2 * -(-len(content) // (2 * _LANES))
    padded = np.zeros(part * _LANES, np.uint8)
    padded[-len(content) :] = content
    padded[len(padded) - len(content) :][:4] ^= 0xFF
    steps = np.ascontiguousarray(padded.view("<u2").reshape(_LANES, part // 2).T)
    table, states = _pair_table(), np.zeros(_LANES, np.uint32)
    for pair in steps:
        states = table[(states ^ pair) & 0xFFFF] ^ (states >> 16)
    carry = _over_zeros(part)
    while len(states) > 1:
        states = _apply(carry, states[0::2]) ^ states[1::2]
        carry = _apply(carry, carry)
    return int(states[0]) ^ 0xFFFFFFFF


@cache
def _byte_table() -> Table:
    """State (256,) after one byte."""
    state = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        state = np.where(state & 1, (state >> 1) ^ np.uint32(_POLYNOMIAL), state >> 1)
    return state


@cache
def _pair_table() -> Table:
    """State (65536,) after two bytes."""
    return _step(_step(np.arange(1 << 16, dtype=np.uint32)))


def _step(state: Table) -> Table:
    """States after one zero byte."""
    return _byte_table()[state & 0xFF] ^ (state >> 8)


@cache
def _over_zeros(count: int) -> Table:
    """Linear map (4, 256) of a state, by its four bytes, to the state `count` zero bytes later."""
    shifts = 8 * np.arange(4, dtype=np.uint32)[:, None]
    result = np.arange(256, dtype=np.uint32) << shifts
    power = _step(result)
    while count:
        if count & 1:
            result = _apply(power, result)
        power, count = _apply(power, power), count >> 1
    return result


def _apply(linear: Table, state: Table) -> Table:
    a, b, c, d = (linear[byte][(state >> (8 * byte)) & 0xFF] for byte in range(4))
    return a ^ b ^ c ^ d

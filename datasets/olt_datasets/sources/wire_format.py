"""Protocol buffer messages, read from their wire format: only the fields that are asked for, and those strictly.

Encoding as in the Protocol Buffers documentation ("Encoding"). Nothing is copied: bytes and embedded messages are views
of the message that they are in, so fields that nobody asks for are jumped over without being read.
"""

from collections.abc import Collection, Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from olt_generator.errors import InputError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
_SIZES = {FIXED64: 8, FIXED32: 4}
_LONGEST_VARINT = 10
# More values of one field than this are taken for damage: noise must not grow in memory.
_MOST_VALUES = 4096

Single = TypeVar("Single", int, memoryview)
Field = tuple[int, int, int, memoryview]
"""Number, wire type, the value of a varint (else 0), and the bytes of anything else (else none)."""


class Message:
    """The wanted fields of one message, by their numbers.

    Where a field is absent its value is that of the format: 0, no bytes, no values. Every reading method raises an
    `InputError` where the field is of another type, or occurs twice and is no list.
    """

    def __init__(self, content: memoryview, wanted: Collection[int], where: str) -> None:
        """Read a message.

        Args:
            content: its bytes.
            wanted: numbers of the fields to keep.
            where: what errors call the message.

        Raises:
            InputError: the bytes are no message.
        """
        self._where = where
        self._fields: dict[int, list[Field]] = {number: [] for number in wanted}
        for field in _fields(content, where):
            if field[0] in self._fields:
                self._fields[field[0]].append(field)
                if len(self._fields[field[0]]) > _MOST_VALUES:
                    raise InputError(f"{where}: field {field[0]} occurs more than {_MOST_VALUES} times; copy it again")

    def number(self, number: int) -> int:
        """A signed integer or an enumeration."""
        values = [value for _, _, value, _ in self._of_type(number, VARINT)]
        value = self._only(number, values, 0)
        return value - (1 << 64) if value >> 63 else value

    def data(self, number: int) -> memoryview:
        """Bytes, or the content of an embedded message."""
        return self._only(number, self.all_data(number), memoryview(b""))

    def all_data(self, number: int) -> list[memoryview]:
        """Bytes, or the contents of embedded messages, of a repeated field."""
        return [content for _, _, _, content in self._of_type(number, LENGTH)]

    def text(self, number: int) -> str:
        """A string."""
        try:
            return bytes(self.data(number)).decode()
        except UnicodeDecodeError as error:
            raise InputError(f"{self._where}: field {number} is no text; copy the file again") from error

    def floats(self, number: int) -> NDArray[np.float64]:
        """Values (n,) of a repeated `float`, packed or one by one."""
        return self._numbers(number, FIXED32, "<f4")

    def doubles(self, number: int) -> NDArray[np.float64]:
        """Values (n,) of a repeated `double`, packed or one by one."""
        return self._numbers(number, FIXED64, "<f8")

    def _numbers(self, number: int, kind: int, dtype: str) -> NDArray[np.float64]:
        contents = [content for _, _, _, content in self._of_type(number, kind, LENGTH)]
        size = sum(len(content) for content in contents)
        if size % _SIZES[kind] or size > _MOST_VALUES * _SIZES[kind]:
            raise InputError(f"{self._where}: field {number} has {size} bytes of numbers; copy the file again")
        return np.frombuffer(b"".join(contents), dtype).astype(np.float64)

    def _of_type(self, number: int, *kinds: int) -> list[Field]:
        fields = self._fields[number]
        if any(kind not in kinds for _, kind, _, _ in fields):
            raise InputError(f"{self._where}: field {number} is of another type; copy the file again")
        return fields

    def _only(self, number: int, values: list[Single], default: Single) -> Single:
        if len(values) > 1:
            raise InputError(f"{self._where}: field {number} occurs {len(values)} times; copy the file again")
        return values[0] if values else default


def _fields(content: memoryview, where: str) -> Iterator[Field]:
    nothing = content[:0]
    at = 0
    while at < len(content):
        start = at
        key, at = _varint(content, at, where)
        number, kind = key >> 3, key & 7
        value, size = 0, _SIZES.get(kind, 0)
        if kind == VARINT:
            value, at = _varint(content, at, where)
        elif kind == LENGTH:
            size, at = _varint(content, at, where)
        elif kind not in _SIZES:
            raise InputError(f"{where}: wire type {kind} at byte {start} is none of a message; copy the file again")
        if number == 0 or at + size > len(content):
            raise InputError(f"{where}: field {number} at byte {start} is cut off or damaged; copy the file again")
        yield number, kind, value, content[at : at + size] if kind != VARINT else nothing
        at += size


def _varint(content: memoryview, at: int, where: str) -> tuple[int, int]:
    """An unsigned integer of up to 64 bits, seven bits a byte, and where it ends."""
    value = 0
    for count, byte in enumerate(content[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * count)
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at + count + 1
    raise InputError(f"{where}: the number at byte {at} does not end; copy the file again")

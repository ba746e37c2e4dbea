"""Members of a chunk's zip file, read straight from where they lie.

The directory of an archive is parsed once. No file is held open, so an archive may be shared with forked workers and
sent to others. Only named members are read: what else an archive holds, and what its members are called, does not
matter.
"""

import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar

from olt_generator.errors import InputError

LARGEST_MEMBER = 1 << 30
"""Bytes. A member of a real clip has a few tens of MB; a larger one is damage or a decompression bomb."""

# Fixed part of a member's own header: its signature and, at the end, the lengths of name and extra field.
_HEADER = struct.Struct("<4s22xHH")
_SIGNATURE = b"PK\x03\x04"
_ENCRYPTED = 0x1

Result = TypeVar("Result")


@dataclass(frozen=True)
class ByteRange:
    """Bytes of a file: those from `start` on, `size` of them."""

    path: Path
    start: int
    size: int


@dataclass(frozen=True)
class _Member:
    header: int
    method: int
    packed_size: int
    size: int
    checksum: int
    encrypted: bool


class ChunkArchive:
    """The members of one zip file.

    Raises:
        InputError: the file is missing or no readable zip file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._members = _guard(path, lambda: _read_directory(path))

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def read(self, name: str) -> bytes:
        """One whole member, held against its checksum.

        Raises:
            InputError: it is missing, damaged, encrypted, too large, or packed in an unusual way.
        """
        member = self._member(name)
        packed = _guard(self.path, lambda: self._read_packed(member, name))
        data = self._unpack(packed, member, name)
        if len(data) != member.size or zlib.crc32(data) != member.checksum:
            raise self._damaged(name)
        return data

    def locate(self, name: str) -> ByteRange | None:
        """Where an uncompressed member lies in the file; None for a compressed one.

        Raises:
            InputError: see `read`.
        """
        member = self._member(name)
        if member.method != zipfile.ZIP_STORED:
            return None
        return ByteRange(self.path, _guard(self.path, lambda: self._find_start(member, name)), member.size)

    def _member(self, name: str) -> _Member:
        if name not in self._members:
            raise InputError(f"{self.path}: member {name} is missing; build the clip again")
        member = self._members[name]
        if member.size > LARGEST_MEMBER:
            raise InputError(
                f"{self.path}: member {name} claims {member.size} bytes; no clip is as large, build it again"
            )
        if member.encrypted or member.method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(f"{self.path}: member {name} is encrypted or packed in an unusual way; store it plainly")
        return member

    def _read_packed(self, member: _Member, name: str) -> bytes:
        with self.path.open("rb") as file:
            file.seek(self._start(file, member, name))
            return file.read(member.packed_size)

    def _find_start(self, member: _Member, name: str) -> int:
        with self.path.open("rb") as file:
            return self._start(file, member, name)

    def _start(self, file: BinaryIO, member: _Member, name: str) -> int:
        file.seek(member.header)
        header = file.read(_HEADER.size)
        if len(header) < _HEADER.size or not header.startswith(_SIGNATURE):
            raise self._damaged(name)
        _, name_length, extra_length = _HEADER.unpack(header)
        return member.header + _HEADER.size + name_length + extra_length

    def _unpack(self, packed: bytes, member: _Member, name: str) -> bytes:
        if member.method == zipfile.ZIP_STORED:
            return packed
        try:
            # One byte more than promised is enough to know that the promise is broken.
            return zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed, member.size + 1)
        except zlib.error as error:
            raise self._damaged(name) from error

    def _damaged(self, name: str) -> InputError:
        return InputError(f"{self.path}: member {name} is damaged; build the clip again")


def _read_directory(path: Path) -> dict[str, _Member]:
    with zipfile.ZipFile(path) as archive:
        return {
            info.filename: _Member(
                info.header_offset,
                info.compress_type,
                info.compress_size,
                info.file_size,
                info.CRC,
                bool(info.flag_bits & _ENCRYPTED),
            )
            for info in archive.infolist()
        }


def _guard(path: Path, read: Callable[[], Result]) -> Result:
    try:
        return read()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; the clip store is incomplete") from error
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path}: damaged zip file ({error}); build its clips again") from error

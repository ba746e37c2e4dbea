"""Members of a chunk's zip file, read straight from where they lie.

The directory of an archive is parsed once. No file is held open, so an archive may be shared with forked workers and
sent to others. Only named members are read: what else an archive holds, and what its members are called, does not
matter.
"""

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from olt_generator.errors import InputError

LARGEST_MEMBER = 1 << 30
"""Bytes. A member of a real clip has a few tens of MB; a larger one is damage or a decompression bomb."""
UNREADABLE = (zipfile.BadZipFile, NotImplementedError, OSError, ValueError)
"""What `zipfile` raises on archives that it cannot list; the last of names that are no text."""

# Fixed part of a member's own header: its signature and, at the end, the lengths of name and extra field.
_HEADER = struct.Struct("<4s22xHH")
_SIGNATURE = b"PK\x03\x04"
_ENCRYPTED = 0x1


@dataclass(frozen=True)
class ByteRange:
    """Bytes of a file: those from `start` on, `size` of them."""

    path: Path
    start: int
    size: int


class ChunkArchive:
    """The members of one zip file; an `InputError` where the file is missing or no readable zip file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with _readable(path), zipfile.ZipFile(path) as archive:
            self._members = {info.filename: info for info in archive.infolist()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all members."""
        return tuple(self._members)

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def read(self, name: str) -> bytes:
        """One whole member; an `InputError` where it is missing, damaged, encrypted, too large, or oddly packed."""
        member = self._member(name)
        with _readable(self.path), self.path.open("rb") as file:
            file.seek(self._find_start(member))
            data = file.read(member.compress_size)
        if member.compress_type == zipfile.ZIP_DEFLATED:
            try:
                # One byte more than promised is enough to know that the promise is broken.
                data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, member.file_size + 1)
            except zlib.error as error:
                raise self._damaged(member) from error
        if len(data) != member.file_size or zlib.crc32(data) != member.CRC:
            raise self._damaged(member)
        return data

    def locate(self, name: str) -> ByteRange | None:
        """Where an uncompressed member lies in the file; None for a compressed one. Errors are those of `read`."""
        member = self._member(name)
        if member.compress_type != zipfile.ZIP_STORED:
            return None
        with _readable(self.path):
            return ByteRange(self.path, self._find_start(member), member.file_size)

    def _member(self, name: str) -> zipfile.ZipInfo:
        if name not in self._members:
            raise InputError(f"{self.path}: member {name} is missing; build the clip again")
        member = self._members[name]
        if member.file_size > LARGEST_MEMBER:
            raise InputError(
                f"{self.path}: member {name} claims {member.file_size} bytes; no clip is as large, build it again"
            )
        if member.flag_bits & _ENCRYPTED or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(f"{self.path}: member {name} is encrypted or packed in an unusual way; store it plainly")
        return member

    def _find_start(self, member: zipfile.ZipInfo) -> int:
        with self.path.open("rb") as file:
            file.seek(member.header_offset)
            header = file.read(_HEADER.size)
        if len(header) < _HEADER.size or not header.startswith(_SIGNATURE):
            raise self._damaged(member)
        _, name_length, extra_length = _HEADER.unpack(header)
        return member.header_offset + _HEADER.size + name_length + extra_length

    def _damaged(self, member: zipfile.ZipInfo) -> InputError:
        return InputError(f"{self.path}: member {member.filename} is damaged; build the clip again")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; build the clips again")
        yield
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; the clip store is incomplete") from error
    except UNREADABLE as error:
        raise InputError(f"{path}: damaged zip file ({error}); build its clips again") from error

"""Zip archives from outside: their members' names, sizes and packing are looked at before any is read.

Nothing is unpacked to disk, so a name can lead nowhere; names that would lead out of a folder are refused all the same,
as whoever unpacks such an archive elsewhere is misled.
"""

import zipfile
from pathlib import Path

from olt_generator.errors import InputError
from olt_toolkit.clips.chunk_archive import UNREADABLE, ChunkArchive
from olt_toolkit.clips.verification.archive_checks import LARGEST_RATIO, is_safe_name

MOST_MEMBERS = 100_000
LARGEST_MEMBER = 256 << 20
_SMALL = 1 << 20


class Archive:
    """The members of a zip archive by name.

    Raises:
        InputError: it is no zip archive, has more members than any scene, or one whose name leads out of it or is
            there twice.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._archive = ChunkArchive(path)
        try:
            with zipfile.ZipFile(path) as archive:
                self._members = {member.filename: member for member in archive.infolist()}
                names = archive.namelist()
        except UNREADABLE as error:
            raise InputError(f"{path}: not readable as a zip archive ({error}); copy it again") from error
        if len(names) > MOST_MEMBERS:
            raise InputError(f"{path}: {len(names)} members; a scene has up to {MOST_MEMBERS}")
        wrong = next((name for name in names if not is_safe_name(name)), None)
        if wrong is not None:
            raise InputError(f"{path}: member {wrong[:80]!r} has a name that leads out of the archive")
        if len(self._members) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{path}: member {twice[:80]!r} is there twice")

    def names(self) -> list[str]:
        """Names of all members, sorted."""
        return sorted(self._members)

    def read(self, name: str) -> bytes:
        """One whole member.

        Raises:
            InputError: it is missing, damaged, encrypted, larger than LARGEST_MEMBER, or packed as bombs are.
        """
        member = self._members.get(name)
        if member is None:
            raise InputError(f"{self.path}: member {name} is missing")
        if member.file_size > LARGEST_MEMBER:
            raise InputError(
                f"{self.path}: member {name} claims {member.file_size} bytes; up to {LARGEST_MEMBER} are read"
            )
        if member.file_size > max(_SMALL, LARGEST_RATIO * member.compress_size):
            raise InputError(f"{self.path}: member {name} unpacks to over {LARGEST_RATIO:g} times its size")
        return self._archive.read(name)

"""Whether a zip file may be unpacked: names that stay in their folder, no links, no bombs, members of their own."""

import stat
import struct
import zipfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path, PurePosixPath

from olt_toolkit.clips.chunk_archive import LARGEST_MEMBER, UNREADABLE
from olt_toolkit.clips.verification.findings import Finding, judge, state

LARGEST_RATIO = 200.0
"""Of declared size to packed size, for members of 10 MiB or more: video does not shrink, tables of runs by 100."""
_SMALL = 10 << 20
_LOCAL_HEADER = struct.Struct("<4s5H3I2H")  # APPNOTE.TXT 4.3.7
_ENCRYPTED, _UTF8 = 0x1, 0x800


def check_archive(path: Path) -> Iterator[Finding]:
    """Look at every entry of a zip file's directory, whether anything reads it or not; nothing is unpacked."""
    where = str(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except UNREADABLE as error:
        yield state("readable archive", where, False, f"damaged zip file ({error}); build its clips again")
        return
    yield state("readable archive", where, True, f"{len(members)} members")
    yield _name_first(
        "safe member names",
        where,
        [member.filename for member in members if not is_safe_name(member.orig_filename)],
        "names that leave the folder, or that systems read differently; take them out of the archive",
    )
    names = [member.filename for member in members]
    doubled = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    yield _name_first("members once", where, doubled, "names there more than once; readers take either")
    odd = [member.filename for member in members if not is_plain(member)]
    yield _name_first("plain members", where, odd, "links, folders, devices, encrypted or oddly packed members")
    yield _check_overlap(path, members)
    largest = max((member.file_size for member in members), default=0)
    detail = "bytes that the largest member declares; no clip is as large"
    yield judge("member size", where, float(largest), float(LARGEST_MEMBER), detail)
    ratios = [member.file_size / max(member.compress_size, 1) for member in members if member.file_size >= _SMALL]
    detail = "times the packed size, of the member that grows most; a decompression bomb"
    yield judge("member ratio", where, max(ratios, default=1.0), LARGEST_RATIO, detail)


def is_safe_name(name: str) -> bool:
    """Whether a member's name is a plain file name below its folder on every system."""
    path = PurePosixPath(name)
    odd = any(character in name for character in "\\:\0") or any(ord(character) < 32 for character in name)
    return bool(name) and not odd and not path.is_absolute() and not {"..", "."} & set(name.split("/"))


def is_plain(member: zipfile.ZipInfo) -> bool:
    """Whether a member is a file, stored or deflated, that anybody can read."""
    mode = member.external_attr >> 16
    kind = stat.S_IFMT(mode)
    packed = member.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    return packed and not member.is_dir() and not member.flag_bits & _ENCRYPTED and kind in (0, stat.S_IFREG)


def _check_overlap(path: Path, members: Sequence[zipfile.ZipInfo]) -> Finding:
    """Whether each member has bytes of its own, behind a header that tells the name of the directory."""
    spans = []
    with path.open("rb") as file:
        for member in members:
            file.seek(member.header_offset)
            header = file.read(_LOCAL_HEADER.size)
            if len(header) < _LOCAL_HEADER.size or not header.startswith(b"PK\x03\x04"):
                return state("member headers", str(path), False, f"{member.filename}: no header where it should be")
            *_, name_length, extra_length = _LOCAL_HEADER.unpack(header)
            name = file.read(name_length).decode("utf-8" if member.flag_bits & _UTF8 else "cp437", errors="replace")
            if name != member.orig_filename:
                return state("member headers", str(path), False, f"{member.filename} is called {name!r} in its header")
            start = member.header_offset
            spans.append((start, start + len(header) + name_length + extra_length + member.compress_size, name))
    for (_, end, first), (start, _, second) in pairwise(sorted(spans)):
        if start < end:
            return state("member headers", str(path), False, f"{first} and {second} share bytes; a bomb does so")
    return state("member headers", str(path), True, "each has bytes of its own")


def _name_first(check: str, where: str, found: Sequence[str], what: str) -> Finding:
    return judge(check, where, float(len(found)), 0.0, what + "".join(f", as {name!r}" for name in found[:1]))

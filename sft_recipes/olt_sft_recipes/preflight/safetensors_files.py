"""Headers of safetensors files, held against the size of the file; no tensor is read unless it is asked for.

Format: 8 bytes of little-endian length, a JSON object of that length, then the tensors without gaps
(https://github.com/huggingface/safetensors, "Format").
"""

import math
from dataclasses import dataclass
from pathlib import Path

from olt_generator.errors import InputError
from olt_toolkit.runtime.json_files import parse_json

_LENGTH = 8
_LONGEST_HEADER = 100_000_000
_METADATA = "__metadata__"
BITS = {
    **dict.fromkeys(("BOOL", "U8", "I8", "F8_E4M3", "F8_E5M2", "F8_E8M0"), 8),
    **dict.fromkeys(("I16", "U16", "F16", "BF16"), 16),
    **dict.fromkeys(("I32", "U32", "F32"), 32),
    **dict.fromkeys(("I64", "U64", "F64", "C64"), 64),
    "F4": 4,
}
"""Bits of a value, by the name of its type."""


@dataclass(frozen=True)
class StoredTensor:
    """Where a tensor lies in its file and what it is; `size` in bytes."""

    file: Path
    dtype: str
    shape: tuple[int, ...]
    start: int
    size: int

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def read(self, most_bytes: int) -> bytes:
        """The first bytes of the tensor."""
        with self.file.open("rb") as file:
            file.seek(self.start)
            return file.read(min(self.size, most_bytes))


def read_header(path: Path) -> dict[str, StoredTensor]:
    """The tensors of a file by name.

    Raises:
        InputError: the file is missing, its header is damaged, or it is shorter or longer than its header says.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            length = int.from_bytes(file.read(_LENGTH), "little")
            if size < _LENGTH or length > min(size - _LENGTH, _LONGEST_HEADER):
                raise InputError(f"{path}: {size} bytes, too few for its header; fetch or copy it again")
            content = file.read(length)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); fetch or copy it again") from error
    header = parse_json(content, f"{path}: header")
    if not isinstance(header, dict):
        raise InputError(f"{path}: its header is no object; fetch or copy it again")
    start = _LENGTH + length
    tensors = {name: _read_entry(path, name, of, start) for name, of in header.items() if name != _METADATA}
    _check_extent(path, tensors, start, size)
    return tensors


def _read_entry(path: Path, name: str, entry: object, start: int) -> StoredTensor:
    try:
        assert isinstance(entry, dict)
        dtype, shape, (first, end) = entry["dtype"], tuple(entry["shape"]), entry["data_offsets"]
        tensor = StoredTensor(path, dtype, shape, start + first, end - first)
        whole = all(isinstance(side, int) and side >= 0 for side in (*shape, first, end))
        right = whole and dtype in BITS and tensor.count * BITS[dtype] == 8 * tensor.size
    except (AssertionError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: header: {name} is no tensor; fetch or copy it again") from error
    if not right:
        raise InputError(f"{path}: header: {name}: {dtype} {shape} is not {end - first} bytes; fetch or copy it again")
    return tensor


def _check_extent(path: Path, tensors: dict[str, StoredTensor], start: int, size: int) -> None:
    end = start
    for name, tensor in sorted(tensors.items(), key=lambda each: (each[1].start, each[1].size)):
        if tensor.start != end:
            raise InputError(f"{path}: header: {name} does not begin where the tensor before it ends; fetch it again")
        end += tensor.size
    if end != size:
        why = "the file was cut off" if size < end else "something was appended"
        raise InputError(f"{path}: {size} bytes, its header says {end}: {why}; fetch or copy it again")

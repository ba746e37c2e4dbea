"""Headers of safetensors files, held against the size of the file; no tensor is read unless it is asked for.

Format: 8 bytes of little-endian length, a JSON object of that length, then the tensors without gaps
(https://github.com/huggingface/safetensors, "Format").
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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

    def fits(self, other: "StoredTensor") -> bool:
        """Whether it has the shape of another one, and its type; BF16, F16 and F32 stand for each other."""
        types = {self.dtype, other.dtype}
        return self.shape == other.shape and (len(types) == 1 or types <= _MANTISSAS.keys())

    def word(self) -> str:
        """Type and shape."""
        return f"{self.dtype} {self.shape}"

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def read(self, most_bytes: int) -> bytes:
        """The first bytes of the tensor."""
        with self.file.open("rb") as file:
            file.seek(self.start)
            return file.read(min(self.size, most_bytes))


def same_start(one: StoredTensor, other: StoredTensor, most_bytes: int) -> bool:
    """Whether two tensors begin with the same values, the finer one at the precision of the coarser one.

    Types that are neither BF16, F16 nor F32 are the same only byte by byte.
    """
    if one.dtype == other.dtype:
        return one.read(most_bytes) == other.read(most_bytes)
    if not {one.dtype, other.dtype} <= _MANTISSAS.keys():
        return False
    coarse = min(one.dtype, other.dtype, key=_MANTISSAS.__getitem__)
    values = [_at_precision(_floats(each, most_bytes), coarse) for each in (one, other)]
    count = min(map(len, values))
    return bool(count) and np.array_equal(values[0][:count], values[1][:count])


def starts_finite(tensor: StoredTensor, most_bytes: int) -> bool:
    """Whether a tensor begins with values that are numbers; of types other than BF16, F16 and F32 all are taken so."""
    return tensor.dtype not in _MANTISSAS or bool(np.isfinite(_floats(tensor, most_bytes)).all())


_MANTISSAS = {"BF16": 7, "F16": 10, "F32": 23}
"""Bits of precision of the types of weights."""


def _floats(tensor: StoredTensor, most_bytes: int) -> NDArray[np.float32]:
    content = tensor.read(most_bytes)
    if tensor.dtype == "BF16":
        return (np.frombuffer(content, "<u2").astype(np.uint32) << 16).view(np.float32)
    return np.frombuffer(content, {"F16": "<f2", "F32": "<f4"}[tensor.dtype]).astype(np.float32)


def _at_precision(values: NDArray[np.float32], dtype: str) -> NDArray[np.float32]:
    """Rounded to the nearest value of a type, halves to the even one."""
    if dtype == "BF16":
        bits = values.view(np.uint32)
        return ((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16 << 16).view(np.float32)
    return values.astype({"F16": np.float16, "F32": np.float32}[dtype]).astype(np.float32)


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

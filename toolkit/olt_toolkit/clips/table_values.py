"""What the cells of a clip table may hold: checked where a table is read, and before one is written.

A table is looked through in batches, so that neither many rows nor cells that unpack to far more than their file cost
memory.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipKind, NoiseBasis, Split, ViewKind
from olt_toolkit.clips.parquet_files import open_parquet, rows_at_once

OPTIONAL_COLUMNS = frozenset(
    {
        "split",
        "doubts",
        "scale_sigma",
        "acceleration_noise",
        "acceleration_noise_basis",
        "no_sample_reason",
        "country",
        "licence",
        "fingerprint",
        "action_errors",
        "build_options",
        "file_checksums",
    }
)
_NEVER_EMPTY = frozenset({"name", "scene_id", "source", "category"})
_WORDS = {
    "kind": get_args(ClipKind),
    "split": get_args(Split),
    "acceleration_noise_basis": get_args(NoiseBasis),
    "views: kind": get_args(ViewKind),
}
_TIMES = ("start_us", "end_us", "duration_us", "sample_t0_us")
# Bytes. A name becomes the name of a file, with a suffix.
_LONGEST = {"name": 200, "fingerprint": 1 << 20, "build_options": 1 << 20}
_LONGEST_TEXT = 4096
# Doubles hold whole microseconds up to here, and sums of a few such times do not overflow.
_LATEST_US = 2**53
# Shares are sums of rounded numbers.
_ROUNDING = 1e-9

Flags = NDArray[np.bool_]


def check_file(path: Path) -> None:
    """Check every cell of a Parquet file whose columns are those of a clip table, but for the uniqueness of its ids.

    Raises:
        InputError: names the file, the column, the value and the row (from 0).
    """
    with open_parquet(path, str(path)) as file:
        if file.metadata.num_rows > path.stat().st_size:
            raise InputError(f"{path}: claims {file.metadata.num_rows} clips, more than its bytes can tell apart")
        texts = [field.name for field in file.schema_arrow if pa.types.is_string(field.type)]
        first = 0
        with pq.ParquetFile(path, read_dictionary=texts, pre_buffer=False, buffer_size=1 << 20) as packed:
            for rows in packed.iter_batches(rows_at_once(packed.metadata)):
                check_rows(pa.Table.from_batches([rows]), str(path), first)
                first += len(rows)


def check_rows(rows: pa.Table, where: str, first: int = 0) -> None:
    """Check every cell of some rows, which errors call `where` and number from `first` on.

    Texts may be dictionaries. Columns that a clip table does not have are not looked at.

    Raises:
        InputError: a cell that must have a value is empty; a word is none of those known; a text holds control
            characters or is far too long; a name cannot be one of a file; a number is not finite, negative or no share;
            times are negative, unsorted, doubled or not those of the clip.
    """
    try:
        rows.validate(full=True)  # texts are UTF-8, offsets lie within their arrays
    except pa.ArrowInvalid as error:
        raise InputError(f"{where}: holds what is no text ({error}); write it again") from error
    table = _Rows(rows, where, first)
    for name in rows.column_names:
        table.check_cells(name)
    table.check_times()
    table.check_errors()
    if "views" in rows.column_names:
        table.check_views()


class _Rows:
    """Rows in one piece each, with what errors call them."""

    def __init__(self, rows: pa.Table, where: str, first: int) -> None:
        self._columns = {name: _whole(rows.column(name)) for name in rows.column_names}
        self._where, self._first = where, first

    def check_cells(self, name: str) -> None:
        column = self._columns[name]
        if name not in OPTIONAL_COLUMNS:
            self._refuse(name, column.is_null().to_numpy(False), None, "has empty cells; every clip needs a value")
        if pa.types.is_list(column.type):
            values = column.flatten()
            empty = values.is_null().to_numpy(False)
            self._refuse(name, empty, None, "has empty cells within its lists", self._owners(name))
            self._check_values(name, values, self._owners(name))
        else:
            self._check_values(name, column, None)

    def check_times(self) -> None:
        start, end, duration = (self._numbers(name) for name in ("start_us", "end_us", "duration_us"))
        self._refuse("end_us", end < start, None, "is less than start_us; a clip ends after it starts")
        self._refuse("duration_us", duration < 0, duration, "a clip does not last less than nothing")
        times, owners = self._columns["sample_t0_us"].flatten().to_numpy(False), self._owners("sample_t0_us")
        outside = (times < 0) | (times > duration[owners])
        self._refuse("sample_t0_us", outside, times, "a sample lies within its clip, from 0 to duration_us", owners)
        unsorted = np.zeros(len(times), bool)
        unsorted[1:] = (np.diff(times) <= 0) & (np.diff(owners) == 0)
        self._refuse("sample_t0_us", unsorted, times, "the times of a clip increase, each once", owners)

    def check_errors(self) -> None:
        """There is one error in the action space for each sample, where there are any."""
        errors, times = self._columns["action_errors"], self._columns["sample_t0_us"]
        differ = (errors.is_valid().to_numpy(False)) & (_lengths(errors) != _lengths(times))
        self._refuse("action_errors", differ, _lengths(errors), "values must be as many as those of sample_t0_us")

    def check_views(self) -> None:
        owners, views = self._owners("views"), self._columns["views"].flatten()
        for field in views.type:
            name, values = f"views: {field.name}", views.field(field.name)
            if field.name != "seed":
                self._refuse(name, values.is_null().to_numpy(False), None, "has empty cells", owners)
            self._check_values(name, values, owners)
        shares = [views.field(f"{name}_share").to_numpy(False) for name in ("observed", "invented", "other_times")]
        for name, share in zip(("observed", "invented", "other_times"), shares, strict=True):
            wrong = ~((share >= 0.0) & (share <= 1.0 + _ROUNDING))
            self._refuse(f"views: {name}_share", wrong, share, "a share is from 0 to 1", owners)
        observed, invented, other = shares
        together = observed + invented
        self._refuse("views: observed_share", together > 1.0 + _ROUNDING, together, "with the invented above 1", owners)
        above = other > observed + _ROUNDING
        self._refuse("views: other_times_share", above, other, "it is a part of observed_share", owners)
        cameras = list(zip(owners.tolist(), views.field("camera").to_pylist(), strict=True))
        twice = pd.Series(cameras, dtype=object).duplicated().to_numpy()
        self._refuse("views: camera", twice, [camera for _, camera in cameras], "each camera is there once", owners)

    def _check_values(self, name: str, values: pa.Array, owners: NDArray[np.int64] | None) -> None:
        """Check what can be told of one column alone: `values` of the rows `owners`, or of one row each."""
        if pa.types.is_dictionary(values.type):
            wrong, rule = _wrong_texts(name, values.dictionary)
            if wrong.any():
                used = wrong[values.indices.fill_null(0).to_numpy(False)] & values.is_valid().to_numpy(False)
                self._refuse(name, used, values, rule, owners)
        elif pa.types.is_string(values.type) or pa.types.is_binary(values.type):
            wrong, rule = _wrong_texts(name, values)
            self._refuse(name, wrong, values, rule, owners)
        elif pa.types.is_floating(values.type):
            numbers = values.fill_null(0.0).to_numpy(False)
            self._refuse(
                name, ~(np.isfinite(numbers) & (numbers >= 0.0)), numbers, "it is finite and at least 0", owners
            )
        elif name in _TIMES:
            numbers = values.fill_null(0).to_numpy(False)
            far = (numbers > _LATEST_US) | (numbers < -_LATEST_US)
            self._refuse(name, far, numbers, f"times in microseconds are within {_LATEST_US}", owners)

    def _numbers(self, name: str) -> NDArray[np.int64]:
        return self._columns[name].to_numpy(False)

    def _owners(self, name: str) -> NDArray[np.int64]:
        """The row of each value of a column of lists."""
        column = self._columns[name]
        return np.repeat(np.arange(len(column)), _lengths(column))

    def _refuse(
        self, label: str, wrong: Flags, values: Any, rule: str, owners: NDArray[np.int64] | None = None
    ) -> None:
        """InputError for the first value that is wrong; `rule` says what all must be, or all of it without values."""
        if not wrong.any():
            return
        place = int(np.argmax(wrong))
        row = self._first + (place if owners is None else int(owners[place]))
        if values is None:
            raise InputError(f"{self._where}: column {label} {rule} (row {row})")
        value = values[place]
        shown = (
            value.as_py() if isinstance(value, pa.Scalar) else value.item() if isinstance(value, np.generic) else value
        )
        raise InputError(f"{self._where}: column {label} has {shown!r:.80}; {rule} (row {row})")


def _wrong_texts(name: str, texts: pa.Array) -> tuple[Flags, str]:
    """Which texts (or bytes) are not allowed in a column, by the first rule that any breaks, and the rule."""
    sizes = _sizes(texts)
    most = _LONGEST.get(name, _LONGEST_TEXT)
    rules: list[tuple[Callable[[], Flags], str]] = [(lambda: sizes > most, f"it has at most {most} bytes")]
    if pa.types.is_string(texts.type) and name != "build_options":
        rules.append((lambda: _hold(texts, _is_control), "it holds no line breaks and other control characters"))
    if name in _NEVER_EMPTY:
        rules.append((lambda: (sizes == 0) & texts.is_valid().to_numpy(False), "it is not empty"))
    if name == "name":
        rules.append((lambda: _hold(texts, _is_separator), "it becomes the name of a file and holds no / or \\"))
        rules.append((lambda: _equal(texts, (".", "..")), "it becomes the name of a file"))
    if name in _WORDS:
        words = _WORDS[name]
        rules.append((lambda: ~_equal(texts, (*words, None)), f"it must be one of {', '.join(words)}"))
    for find, rule in rules:
        if (wrong := find()).any():
            return wrong, rule
    return np.zeros(len(texts), bool), ""


def _equal(texts: pa.Array, words: tuple[str | None, ...]) -> Flags:
    return np.isin(texts.to_numpy(False), np.array(words, object))


def _is_control(content: NDArray[np.uint8]) -> Flags:
    """Which bytes of UTF-8 begin a control character: C0, DEL, and C1, which is two bytes."""
    if content.min() >= 0x20 and content.max() < 0x7F:  # nearly always, and ten times as fast
        return np.zeros(len(content), bool)
    found = (content < 0x20) | (content == 0x7F)
    found[:-1] |= (content[:-1] == 0xC2) & (content[1:] < 0xA0)
    return found


def _is_separator(content: NDArray[np.uint8]) -> Flags:
    return (content == ord("/")) | (content == ord("\\"))


def _hold(texts: pa.Array, is_wrong: Callable[[NDArray[np.uint8]], Flags]) -> Flags:
    """Which texts hold a byte that is wrong."""
    edges = _edges(texts)
    held = np.zeros(len(texts), bool)
    data = texts.buffers()[2]
    if data is not None:
        content = np.frombuffer(data, np.uint8)[edges[0] : edges[-1]]
        if len(content):
            held[np.searchsorted(edges, edges[0] + np.flatnonzero(is_wrong(content)), "right") - 1] = True
    return held


def _edges(texts: pa.Array) -> NDArray[np.int32]:
    """Where texts begin and end in their buffer."""
    offsets = texts.buffers()[1]
    return (
        np.zeros(1, np.int32) if offsets is None else np.frombuffer(offsets, np.int32)[texts.offset :][: len(texts) + 1]
    )


def _sizes(texts: pa.Array) -> NDArray[np.int32]:
    return np.diff(_edges(texts)) if len(texts) else np.zeros(0, np.int32)


def _lengths(column: pa.Array) -> NDArray[np.int64]:
    return column.value_lengths().fill_null(0).to_numpy(False).astype(np.int64)


def _whole(column: pa.ChunkedArray) -> pa.Array:
    if column.num_chunks == 1:
        return column.chunk(0)
    return column.combine_chunks() if column.num_chunks else pa.array([], column.type)

"""What the cells of a clip table may hold: checked where a table is read, and before one is written."""

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from olt_generator.errors import InputError
from olt_toolkit.clips.clip import ClipKind, NoiseBasis, Split, ViewKind

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


def longest_text(column: str) -> int:
    """Most bytes of a text, or of bytes, in a column."""
    return _LONGEST.get(column, _LONGEST_TEXT)


def check_rows(rows: pa.Table, where: str, first: int = 0) -> None:
    """Check every cell of some rows, which errors call `where` and number from `first` on.

    Texts are UTF-8; they and lists may be large ones. Columns that a clip table does not have are not looked at.

    Raises:
        InputError: a cell that must have a value is empty; a word is none of those known; a text holds control
            characters or is far too long; a name cannot be one of a file; a number is not finite, negative or no share;
            times are negative, unsorted, doubled or not those of the clip.
    """
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
        if name in OPTIONAL_COLUMNS and column.null_count == len(column):
            return
        if name not in OPTIONAL_COLUMNS:
            self._refuse_nulls(name, column, "has empty cells; every clip needs a value")
        if pa.types.is_list(column.type) or pa.types.is_large_list(column.type):
            values, owners = column.flatten(), self._owners(name)
            self._refuse_nulls(name, values, "has empty cells within its lists", owners)
            self._check_values(name, values, owners)
        else:
            self._check_values(name, column)

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
        if errors.null_count == len(errors):
            return
        differ = (errors.is_valid().to_numpy(False)) & (_lengths(errors) != _lengths(times))
        self._refuse("action_errors", differ, _lengths(errors), "values must be as many as those of sample_t0_us")

    def check_views(self) -> None:
        owners, views = self._owners("views"), self._columns["views"].flatten()
        if not len(views):
            return
        shares = [views.field(f"{name}_share").to_numpy(False) for name in ("observed", "invented", "other_times")]
        for name, share in zip(("observed", "invented", "other_times"), shares, strict=True):
            wrong = ~((share >= 0.0) & (share <= 1.0 + _ROUNDING))
            self._refuse(f"views: {name}_share", wrong, share, "a share is from 0 to 1", owners)
        observed, invented, other = shares
        together = observed + invented
        self._refuse("views: observed_share", together > 1.0 + _ROUNDING, together, "with the invented above 1", owners)
        above = other > observed + _ROUNDING
        self._refuse("views: other_times_share", above, other, "it is a part of observed_share", owners)
        cameras = views.field("camera").dictionary_encode()
        camera_of_clip = owners * len(cameras.dictionary) + cameras.indices.to_numpy(False)
        twice = pd.Series(camera_of_clip).duplicated().to_numpy()
        self._refuse("views: camera", twice, cameras, "each camera is there once", owners)

    def _check_values(self, name: str, values: pa.Array, owners: NDArray[np.int64] | None = None) -> None:
        """Check what can be told of one column alone: `values` of the rows `owners`, or of one row each."""
        if values.null_count == len(values):
            return
        if pa.types.is_struct(values.type):
            for field in values.type:
                part, label = values.field(field.name), f"{name}: {field.name}"
                if field.name != "seed":
                    self._refuse_nulls(label, part, "has empty cells", owners)
                self._check_values(label, part, owners)
        elif _is_text(values) or _is_bytes(values):
            wrong, rule = _wrong_texts(name, values)
            self._refuse(name, wrong, values, rule, owners)
        elif pa.types.is_floating(values.type):
            numbers = _filled(values)
            self._refuse(
                name, ~(np.isfinite(numbers) & (numbers >= 0.0)), numbers, "it is finite and at least 0", owners
            )
        elif name in _TIMES:
            numbers = _filled(values)
            far = (numbers > _LATEST_US) | (numbers < -_LATEST_US)
            self._refuse(name, far, numbers, f"times in microseconds are within {_LATEST_US}", owners)

    def _numbers(self, name: str) -> NDArray[np.int64]:
        return self._columns[name].to_numpy(False)

    def _owners(self, name: str) -> NDArray[np.int64]:
        """The row of each value of a column of lists."""
        column = self._columns[name]
        return np.repeat(np.arange(len(column)), _lengths(column))

    def _refuse_nulls(self, label: str, values: pa.Array, rule: str, owners: NDArray[np.int64] | None = None) -> None:
        if values.null_count:
            self._refuse(label, values.is_null().to_numpy(False), None, rule, owners)

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
    most = longest_text(name)
    rules: list[tuple[Callable[[], Flags], str]] = [(lambda: sizes > most, f"it has at most {most} bytes")]
    if _is_text(texts) and name != "build_options":
        rules.append((lambda: _hold(texts, _is_control), "it holds no line breaks and other control characters"))
    if name in _NEVER_EMPTY:
        rules.append((lambda: (sizes == 0) & texts.is_valid().to_numpy(False), "it is not empty"))
    if name == "name":
        rules.append((lambda: _hold(texts, _is_separator), "it becomes the name of a file and holds no / or \\"))
        rules.append((lambda: _are_dots(texts, sizes), "it becomes the name of a file"))
    if name in _WORDS:
        words = _WORDS[name]
        rules.append((lambda: ~_are(texts, (*words, None)), f"it must be one of {', '.join(words)}"))
    for find, rule in rules:
        if (wrong := find()).any():
            return wrong, rule
    return np.zeros(len(texts), bool), ""


def _is_text(values: pa.Array) -> bool:
    return pa.types.is_string(values.type) or pa.types.is_large_string(values.type)


def _is_bytes(values: pa.Array) -> bool:
    return pa.types.is_binary(values.type) or pa.types.is_large_binary(values.type)


def _are(texts: pa.Array, words: tuple[str | None, ...]) -> Flags:
    options = pc.SetLookupOptions(pa.array(words, texts.type))
    return pc.call_function("is_in", [texts], options).to_numpy(False)


def _are_dots(texts: pa.Array, sizes: NDArray[Any]) -> Flags:
    """Which texts are names of folders everywhere; only short ones are looked at."""
    found = np.zeros(len(texts), bool)
    short = np.flatnonzero(sizes <= 2)
    found[short] = _are(texts.take(pa.array(short)), (".", ".."))
    return found


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


def _edges(texts: pa.Array) -> NDArray[Any]:
    """Where texts begin and end in their buffer."""
    kind = np.int64 if pa.types.is_large_string(texts.type) or pa.types.is_large_binary(texts.type) else np.int32
    offsets = texts.buffers()[1]
    return np.zeros(1, kind) if offsets is None else np.frombuffer(offsets, kind)[texts.offset :][: len(texts) + 1]


def _sizes(texts: pa.Array) -> NDArray[Any]:
    return np.diff(_edges(texts)) if len(texts) else np.zeros(0, np.int32)


def _filled(values: pa.Array) -> NDArray[Any]:
    """Numbers, with 0 where there is none."""
    return (values.fill_null(0) if values.null_count else values).to_numpy(False)


def _lengths(column: pa.Array) -> NDArray[np.int64]:
    return column.value_lengths().fill_null(0).to_numpy(False).astype(np.int64)


def _whole(column: pa.ChunkedArray) -> pa.Array:
    if column.num_chunks == 1:
        return column.chunk(0)
    return column.combine_chunks() if column.num_chunks else pa.array([], column.type)
